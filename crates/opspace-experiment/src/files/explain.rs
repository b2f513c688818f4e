//! Translation of TOML and serde errors into messages that a user can act on.

use std::ops::Range;

use toml::de::{DeTable, DeValue};

use crate::files::numbers::with_digits;
use crate::files::renamed::present_name;
use crate::files::toml_path::{Part, dotted, keys_at, value_at};
use crate::suggest::{self, nearest, same_but_unit, unit_of, units_differ};

pub(crate) struct Words {
    pub(crate) message: String,
    pub(crate) help: Option<String>,
    pub(crate) part: Part,
}

/// Translates a message of serde or toml into a message for the user.
pub(crate) fn words(raw: &str, base: &str, document: &DeTable<'_>, path: &[String]) -> Words {
    let value = |message: String, help: Option<String>| Words { message, help, part: Part::Value };
    let key = |message: String, help: Option<String>| Words { message, help, part: Part::Key };
    if let Some((name, allowed)) = unknown(raw, "unknown field `") {
        if let Some(new) = present_name(name, &allowed) {
            return key(format!("unknown key `{name}`: it was renamed to `{new}`"), None);
        }
        return key(format!("unknown key `{name}`"), Some(did_you_mean(name, &allowed)));
    }
    if let Some((name, allowed)) = unknown(raw, "unknown variant `") {
        return key(format!("unknown value `{name}`"), Some(did_you_mean(name, &allowed)));
    }
    if let Some((_, allowed)) =
        raw.strip_prefix("unexpected keys in table: ").and_then(|rest| rest.split_once(", available keys: "))
    {
        let name = path.last().map_or("", String::as_str);
        let allowed: Vec<&str> = allowed.split(", ").collect();
        return key(format!("unknown key `{name}`"), Some(did_you_mean(name, &allowed)));
    }
    if let Some(name) = raw.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        let within = if path.is_empty() { String::new() } else { format!(" in `{}`", dotted(path)) };
        let help = match unit_of(name) {
            Some(unit) => format!("add `{name} = ...`: a number in {}", unit.symbol),
            None => format!("add `{name} = ...`: it has no default"),
        };
        return key(format!("missing key `{name}`{within}"), Some(help));
    }
    if raw.starts_with("wanted exactly 1 element") {
        let mut held = keys_at(document, path);
        // The kind in the file comes first, because it is probably the intended one; a setting may have added
        // another.
        let own = DeTable::parse(base).map(|base| keys_at(base.get_ref(), path)).unwrap_or_default();
        held.sort_by_key(|key| !own.contains(key));
        let found = if held.is_empty() { "is empty".to_owned() } else { format!("has {}", list(&held)) };
        let message = format!("`{}` {found}; it must have exactly one kind", dotted(path));
        let help = held.first().map(|kind| format!("a key of `{kind}` is `{}.{kind}.<key>`", dotted(path)));
        return key(message, help);
    }
    if raw == "wanted string or table" {
        return value(format!("expected text or a table, got {}", found_at(document, path)), None);
    }
    for prefix in ["invalid type: ", "invalid value: "] {
        if let Some((_, expected)) = raw.strip_prefix(prefix).and_then(|rest| rest.rsplit_once(", expected "))
        {
            let found = value_at(document, path);
            let message = format!("expected {}, got {}", plain(expected), found_at(document, path));
            let help = found.and_then(|found| type_help(found, expected, path));
            return value(message, help);
        }
    }
    if let Some((length, expected)) =
        raw.strip_prefix("invalid length ").and_then(|rest| rest.split_once(", expected "))
    {
        return value(format!("expected {}, got {length}", plain(expected)), None);
    }
    value(raw.trim_end().to_owned(), None)
}

/// Splits a message like `unknown field x, expected one of a, b` into the unknown name and the allowed names.
fn unknown<'a>(raw: &'a str, prefix: &str) -> Option<(&'a str, Vec<&'a str>)> {
    let rest = raw.strip_prefix(prefix)?;
    if let Some((name, _)) = rest.rsplit_once("`, there are no ") {
        return Some((name, Vec::new()));
    }
    let (name, expected) = rest.rsplit_once("`, expected ")?;
    Some((name, expected.split('`').skip(1).step_by(2).collect()))
}

/// Returns the end of an error about an unknown name: the nearest allowed one, else all that are allowed.
#[must_use]
pub fn did_you_mean(name: &str, allowed: &[&str]) -> String {
    let listed = match allowed {
        [] => "no key or value is allowed here".to_owned(),
        _ => format!("allowed here: {}", list(allowed)),
    };
    match same_but_unit(name, allowed).or_else(|| nearest(name, allowed)) {
        Some(near) => match units_differ(name, near) {
            Some(note) => format!("did you mean `{near}`? {note}\n{listed}"),
            None => format!("did you mean `{near}`?\n{listed}"),
        },
        None => listed,
    }
}

pub(crate) fn list<S: AsRef<str>>(names: &[S]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`{}`", name.as_ref())).collect();
    suggest::list(quoted.iter().map(String::as_str))
}

/// Returns a plain name for a Rust type.
fn plain(expected: &str) -> &str {
    match expected {
        "f64" | "f32" => "a number",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number not below 0",
        "a string" | "str" | "string" | "path string" => "text in quotes",
        "a boolean" | "bool" => "true or false",
        "a map" => "a table",
        "a sequence" => "an array",
        _ if expected.starts_with("struct ") || expected.starts_with("internally") => "a table",
        _ if expected.starts_with("tuple ") => "an array",
        _ => expected,
    }
}

fn found_at(document: &DeTable<'_>, path: &[String]) -> String {
    match value_at(document, path) {
        Some(DeValue::String(text)) => format!("the text {:?}", shorten(text)),
        Some(DeValue::Integer(number)) => number.to_string(),
        Some(DeValue::Float(number)) => number.to_string(),
        Some(DeValue::Boolean(flag)) => flag.to_string(),
        Some(DeValue::Datetime(_)) => "a date".to_owned(),
        Some(DeValue::Array(_)) => "an array".to_owned(),
        Some(DeValue::Table(_)) | None => "a table".to_owned(),
    }
}

fn shorten(text: &str) -> String {
    if text.chars().count() <= 40 { text.to_owned() } else { text.chars().take(39).chain(['…']).collect() }
}

fn type_help(found: &DeValue<'_>, expected: &str, path: &[String]) -> Option<String> {
    let key = path.iter().rfind(|segment| segment.parse::<usize>().is_err())?;
    match (found, plain(expected)) {
        (DeValue::String(text), "a number" | "a whole number" | "a whole number not below 0") => {
            let (number, unit) = leading_number(text)?;
            Some(if unit.is_empty() {
                format!("write the number without quotes: `{key} = {number}`")
            } else if key.ends_with(&format!("_{}", unit.to_lowercase().replace('/', "_per_"))) {
                format!("the unit is part of the key's name: write only the number, `{key} = {number}`")
            } else {
                "write only the number, in the unit at the end of the key's name".to_owned()
            })
        }
        (DeValue::Integer(_), "a number") => {
            Some("this whole number is too large: write it with a decimal point".into())
        }
        _ => None,
    }
}

/// Splits text such as `400 N/m` into the number and the text after it.
fn leading_number(text: &str) -> Option<(&str, &str)> {
    let text = text.trim();
    let ends = text.char_indices().map(|(index, _)| index).chain([text.len()]);
    let end = ends.rev().find(|&end| text[..end].parse().is_ok_and(f64::is_finite))?;
    Some((&text[..end], text[end..].trim()))
}

/// Number without a digit before or after its point in the line of a place, and its form in TOML.
fn number_in_line(text: &str, at: usize) -> Option<[String; 2]> {
    let begin = text.get(..at)?.rfind('\n').map_or(0, |newline| newline + 1);
    with_digits(text[begin..].lines().next()?).map(|(_, forms)| forms)
}

pub(crate) fn syntax_words(raw: &str, text: &str, span: &Range<usize>) -> (String, Option<String>) {
    let at = text.get(span.clone()).unwrap_or("").trim();
    if let Some([found, form]) = number_in_line(text, span.start) {
        let message = format!("`{found}` is not a TOML number: it needs a digit on both sides of the point");
        return (message, Some(format!("write `{form}`")));
    }
    if raw.starts_with("string values must be quoted") || raw.starts_with("invalid boolean") {
        return match leading_number(at) {
            _ if at.is_empty() => ("a value is missing after `=`".to_owned(), None),
            Some((number, _)) => (
                format!("`{at}` is not a TOML value"),
                Some(format!(
                    "the unit is part of the key's name: write only the number in that unit, as in `{number}`"
                )),
            ),
            None => (format!("`{at}` is not a TOML value"), Some(format!("text needs quotes: {at:?}"))),
        };
    }
    if raw == "duplicate key" {
        return (format!("`{at}` is defined twice in this table"), Some("remove one of the two".to_owned()));
    }
    (format!("not TOML: {raw}"), None)
}

// ---- similar names ----
