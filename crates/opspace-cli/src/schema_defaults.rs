//! Defaults in a JSON Schema that schemars doesn't print.

use serde_json::{Map, Value, json};

/// Key of a schema for a default that depends on other values, in words.
pub const IN_WORDS: &str = "x-default";

/// Adds empty lists and tables as defaults: a list or a table of names that may be absent is then empty, and a table that
/// requires no key has the defaults of its keys. Removes `null`, which TOML doesn't have.
pub fn add_empty_defaults(schema: &mut Value) {
    let definitions = schema["$defs"].clone();
    complete(schema, &definitions);
}

fn complete(schema: &mut Value, definitions: &Value) {
    match schema {
        Value::Object(members) => {
            let required = members.get("required").cloned().unwrap_or_default();
            for (key, of) in
                members.get_mut("properties").and_then(Value::as_object_mut).into_iter().flatten()
            {
                let is_required = required.as_array().is_some_and(|keys| keys.contains(&json!(key)));
                let default = if is_required { None } else { empty_value(of, definitions) };
                let Some(of) = of.as_object_mut() else { continue };
                if of.get("default") == Some(&Value::Null) {
                    of.remove("default");
                }
                if let Some(default) = default.filter(|_| !states_default(of)) {
                    of.insert("default".to_owned(), default);
                }
            }
            members.values_mut().for_each(|member| complete(member, definitions));
        }
        Value::Array(members) => members.iter_mut().for_each(|member| complete(member, definitions)),
        _ => {}
    }
}

fn states_default(of: &Map<String, Value>) -> bool {
    of.contains_key("default") || of.contains_key(IN_WORDS)
}

/// Empty list or table, if the schema allows it and does not stand for an optional value.
fn empty_value(of: &Value, definitions: &Value) -> Option<Value> {
    let name = of["$ref"].as_str().and_then(|reference| reference.strip_prefix("#/$defs/"));
    let of = name.map_or(of, |name| &definitions[name]);
    match of["type"].as_str()? {
        "array" if of["minItems"].is_null() => Some(json!([])),
        "object" if of["required"].is_null() => Some(json!({})),
        _ => None,
    }
}
