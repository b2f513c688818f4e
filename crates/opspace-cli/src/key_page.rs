//! Markdown page with every key of a kind of file, from its JSON Schema.

use crate::schema_defaults::IN_WORDS;
use serde_json::{Map, Value};
use std::fmt::Write as _;

/// Returns the page of a schema. `command` is the command that prints it.
pub fn key_page(schema: &Value, title: &str, command: &str) -> String {
    let mut page = Page { schema, sections: Vec::new() };
    page.collect(schema, "");
    let mut text = format!(
        "# {title}\n\nGenerated from the JSON Schema by `{command}`. A key may be absent unless it is required. A default in words depends \
         on other values, `{{}}` stands for a table whose keys have their defaults, and without a default nothing takes the place \
         of the key. `NAME` and `JOINT` are names of your choice, or of the robot's joints.\n"
    );
    page.add_table(&mut text, schema);
    for section in &page.sections {
        let _ = write!(text, "\n## `{}`\n\n{}\n", section.path, prose(&section.of["description"]));
        page.add_table(&mut text, section.of);
    }
    text
}

/// Definition with a section of its own, and the first path at which a file has it.
struct Section<'a> {
    name: &'a str,
    path: String,
    of: &'a Value,
}

struct Page<'a> {
    schema: &'a Value,
    sections: Vec<Section<'a>>,
}

impl<'a> Page<'a> {
    /// Adds a section for each table and choice below a schema, in the order of the file.
    fn collect(&mut self, schema: &'a Value, path: &str) {
        if let Some(name) = reference(schema) {
            let of = &self.schema["$defs"][name];
            let is_known = self.sections.iter().any(|section| section.name == name);
            if !is_known && has_section(of) {
                self.sections.push(Section { name, path: path.to_owned(), of });
                self.collect(of, path);
            }
            return;
        }
        for (key, value) in members(schema) {
            self.collect(value, &path_of(path, key));
        }
        for choice in ["anyOf", "oneOf"] {
            for kind in schema[choice].as_array().into_iter().flatten() {
                self.collect(kind, path);
            }
        }
        if schema["items"].is_object() {
            self.collect(&schema["items"], &format!("{path}[]"));
        }
        if schema["additionalProperties"].is_object() {
            self.collect(&schema["additionalProperties"], &path_of(path, name_of(path)));
        }
    }

    fn add_table(&self, text: &mut String, schema: &Value) {
        if let Some(kinds) = schema["oneOf"].as_array() {
            *text += "\n| value | meaning |\n|---|---|\n";
            for kind in kinds {
                let about = prose(&kind["description"]);
                let value = match members(kind).next() {
                    Some((key, of)) => format!("`{key}` = {}", self.value(of)),
                    None => constant(&kind["const"]),
                };
                let _ = writeln!(text, "| {value} | {about} |");
            }
            return;
        }
        *text += "\n| key | value | default | meaning |\n|---|---|---|---|\n";
        let required: Vec<&str> =
            schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        for (key, of) in members(schema) {
            let default = match (&of[IN_WORDS], &of["default"]) {
                _ if required.contains(&key.as_str()) => "required".to_owned(),
                (Value::String(words), _) => words.clone(),
                (_, Value::Null) => String::new(),
                (_, default) => constant(default),
            };
            let about = match prose(&of["description"]) {
                about if about.is_empty() => prose(&self.resolved(of)["description"]),
                about => about,
            };
            let _ = writeln!(text, "| `{key}` | {} | {default} | {about} |", self.value(of));
        }
    }

    /// Definition that a schema refers to, or the schema itself.
    fn resolved<'b>(&'b self, schema: &'b Value) -> &'b Value {
        reference(schema).map_or(schema, |name| &self.schema["$defs"][name])
    }

    /// Value of a key with its range, in words.
    fn value(&self, schema: &Value) -> String {
        let bounds = [("minimum", "at least"), ("maximum", "at most"), ("exclusiveMaximum", "below")];
        let bounds = bounds.into_iter().filter(|(key, _)| schema[key].is_number());
        bounds.fold(self.kind(schema), |text, (key, words)| format!("{text}, {words} {}", schema[key]))
    }

    /// Kind of a value, in words. A link has the last part of its path: whole paths make columns wide.
    fn kind(&self, schema: &Value) -> String {
        if let Some(section) =
            reference(schema).and_then(|name| self.sections.iter().find(|section| section.name == name))
        {
            let of = match section.of["oneOf"].as_array() {
                Some(kinds) if kinds.iter().all(|kind| !kind["const"].is_null()) => "one of",
                Some(_) => "one key of",
                None => "table",
            };
            let name = section.path.rsplit('.').next().unwrap_or_default();
            return format!("{of} [`{name}`](#{})", anchor(&section.path));
        }
        if reference(schema).is_some() {
            let of = self.resolved(schema);
            // A number in a range: its first line says which.
            return if of["type"] == "array" { self.value(of) } else { range(&of["description"]) };
        }
        if let Some(kinds) = schema["anyOf"].as_array() {
            // A number of all axes, lists of them, or a table of axes.
            if kinds.iter().any(|kind| kind["properties"]["rx"].is_object()) {
                return format!("{}, of all axes, or by axis", self.value(&kinds[0]));
            }
            let kinds = kinds
                .iter()
                .filter(|kind| kind["type"] != "null" && kind["maxProperties"] != 0)
                .map(|kind| self.value(kind));
            return kinds.collect::<Vec<_>>().join(", or ");
        }
        if let Some(values) = schema["enum"].as_array() {
            return values.iter().map(constant).collect::<Vec<_>>().join(", ");
        }
        self.plain_value(schema)
    }

    /// Value of a key whose schema has a type.
    fn plain_value(&self, schema: &Value) -> String {
        let kind = match &schema["type"] {
            Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null"),
            kind => kind.as_str(),
        };
        match kind {
            Some("array") => {
                let count = match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
                    (Some(least), Some(most)) if least == most => format!("{least} × "),
                    _ => String::new(),
                };
                format!("list: {count}{}", self.value(&schema["items"]))
            }
            Some("object") if schema["properties"].is_object() => {
                let keys: Vec<String> = members(schema).map(|(key, _)| format!("`{key}`")).collect();
                format!("table of {}", keys.join(", "))
            }
            Some("object") => format!("table by name: {}", self.value(&schema["additionalProperties"])),
            Some("integer") => "integer".to_owned(),
            Some("boolean") => "`true` or `false`".to_owned(),
            Some(kind) => kind.to_owned(),
            None => "any value".to_owned(),
        }
    }
}

fn reference(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str()?.strip_prefix("#/$defs/")
}

/// True for tables and for choices, which need more than a word.
fn has_section(definition: &Value) -> bool {
    definition["properties"].is_object() || definition["oneOf"].is_array()
}

fn members(schema: &Value) -> impl Iterator<Item = (&String, &Value)> {
    schema["properties"].as_object().into_iter().flat_map(Map::iter)
}

fn path_of(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

/// Placeholder of the names in a table.
fn name_of(path: &str) -> &'static str {
    if path.ends_with("joint") || path.ends_with("servo") || path.ends_with("joints") {
        "JOINT"
    } else {
        "NAME"
    }
}

/// Anchor of a heading, as forges and mdBook derive it.
fn anchor(heading: &str) -> String {
    heading.to_lowercase().chars().filter(|c| c.is_alphanumeric() || matches!(c, '-' | '_')).collect()
}

fn constant(value: &Value) -> String {
    format!("`{value}`")
}

/// Description as one line of a table, without links to Rust's documentation.
fn prose(description: &Value) -> String {
    let text = description.as_str().unwrap_or_default().replace("\n\n", " ").replace('\n', " ");
    text.replace("[`", "`").replace("`]", "`").replace('|', "\\|")
}

/// "A number above zero." as "number above zero".
fn range(description: &Value) -> String {
    let text = prose(description);
    let text = text.trim_end_matches('.');
    let text = text.strip_prefix("A ").or_else(|| text.strip_prefix("An ")).unwrap_or(text);
    let mut rest = text.chars();
    rest.next().map_or_else(String::new, |first| first.to_lowercase().chain(rest).collect())
}
