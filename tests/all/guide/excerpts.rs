//! Excerpts of files: merged into a complete file, or compared with the keys of the schemas.

use crate::cli_common::{opspace, project, read_json};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// Depth up to which an excerpt is merged into a file: `task.NAME.KIND.KEY` is replaced as a whole.
const DEPTH: usize = 3;

const SCHEMAS: [&str; 4] = [
    "tasks/task.schema.json",
    "robots/robot.schema.json",
    "tasks/suite.schema.json",
    "tasks/experiments/experiment.schema.json",
];

/// Runs a task file with an excerpt for a moment, or checks the keys of an excerpt of another file.
pub fn check(folder: &Path, task: Option<&str>, excerpt: &str, place: &str) {
    assert_known_keys(excerpt, place);
    let task_schema = read_json(project(SCHEMAS[0]));
    for table in tables(excerpt, place) {
        let is_of_task = unknown(&task_schema, &[&task_schema], &json(&table), "").is_none();
        let (Some(task), true) = (task, is_of_task) else { continue };
        let mut whole: toml::Table = task.parse().expect("it has run");
        // Events need their time.
        let duration_s =
            if table.contains_key("event") { whole["duration_s"].to_string() } else { "0.2".to_owned() };
        let has_priority = table.contains_key("priority");
        merge(&mut whole, table, DEPTH);
        if has_priority {
            remove_unused_tasks(&mut whole);
        }
        std::fs::write(folder.join("excerpt.toml"), whole.to_string()).expect("a new file");
        let settings = ["--set", "settle_s=0.1", "--duration-s", &duration_s];
        let arguments = ["run", "excerpt.toml", "--out", "runs/excerpt", "--force", "--quiet"];
        let ran = opspace(folder, &[&arguments[..], &settings].concat());
        // In so short a time an expectation may be missed, and a hand touch nothing.
        let is_too_short =
            ["expectation missed", "never touched"].iter().any(|text| ran.stdout.contains(text));
        let is_done = ran.code == 0 || ran.code == 1 && is_too_short;
        assert!(is_done, "{place}: {}{}\n{whole}", ran.stdout, ran.stderr);
    }
}

/// Returns the tables of an excerpt: one, or one for each line if the lines are alternatives.
fn tables(excerpt: &str, place: &str) -> Vec<toml::Table> {
    let whole = excerpt.parse::<toml::Table>();
    let mut keys = BTreeSet::new();
    let is_repeated =
        excerpt.lines().filter_map(|line| line.split(['=', '.']).next()).any(|key| !keys.insert(key));
    match whole {
        Ok(table) => vec![table],
        Err(_) if is_repeated => {
            excerpt.lines().map(|line| line.parse().unwrap_or_else(|e| panic!("{place}: {e}"))).collect()
        }
        Err(error) => panic!("{place}: {error}"),
    }
}

fn json(table: &toml::Table) -> Value {
    serde_json::to_value(table).expect("a table")
}

/// Removes the tasks that a new order of priority does not have.
fn remove_unused_tasks(whole: &mut toml::Table) {
    let priority = whole["priority"].clone();
    let is_used =
        |name: &str| priority.as_array().is_some_and(|names| names.iter().any(|n| n.as_str() == Some(name)));
    if let Some(tasks) = whole["task"].as_table_mut() {
        tasks.retain(|name, _| is_used(name));
    }
}

/// Merges an excerpt; an impedance takes the place of gains, of which a task has only one.
fn merge(into: &mut toml::Table, from: toml::Table, depth: usize) {
    if from.contains_key("impedance") {
        into.remove("gains");
    }
    for (key, value) in from {
        match (into.get_mut(&key), value) {
            (Some(toml::Value::Table(old)), toml::Value::Table(new)) if depth > 0 => {
                merge(old, new, depth - 1)
            }
            (_, value) => {
                into.insert(key, value);
            }
        }
    }
}

/// Checks that a schema knows all keys of an excerpt: of a file, or of a table of a file.
pub fn assert_known_keys(excerpt: &str, place: &str) {
    for table in tables(excerpt, place) {
        let value = json(&table);
        let is_known = SCHEMAS.iter().any(|path| {
            let root = read_json(project(path));
            let tables = root["$defs"].as_object().into_iter().flat_map(|tables| tables.values());
            [&root].into_iter().chain(tables).any(|schema| unknown(&root, &[schema], &value, "").is_none())
        });
        let unknown = SCHEMAS.map(|path| {
            let root = read_json(project(path));
            unknown(&root, &[&root], &value, "")
        });
        assert!(is_known, "{place}: no table of a file has all keys; unknown in a file: {unknown:?}");
    }
}

/// Returns the path of a key that none of the schemas has.
fn unknown(root: &Value, schemas: &[&Value], value: &Value, at: &str) -> Option<String> {
    let schemas = alternatives(root, schemas);
    match value {
        Value::Object(table) => table.iter().find_map(|(key, value)| {
            let path = format!("{at}.{key}");
            let of: Vec<&Value> = schemas.iter().filter_map(|schema| member(schema, key)).collect();
            if of.is_empty() { Some(path) } else { unknown(root, &of, value, &path) }
        }),
        Value::Array(items) => items.iter().find_map(|item| {
            let of: Vec<&Value> =
                schemas.iter().map(|schema| &schema["items"]).filter(|items| items.is_object()).collect();
            unknown(root, &of, item, &format!("{at}[]"))
        }),
        _ => None,
    }
}

fn member<'a>(schema: &'a Value, key: &str) -> Option<&'a Value> {
    schema["properties"]
        .get(key)
        .or_else(|| Some(&schema["additionalProperties"]).filter(|of| of.is_object()))
}

/// Returns the schemas with references and choices resolved.
fn alternatives<'a>(root: &'a Value, schemas: &[&'a Value]) -> Vec<&'a Value> {
    let mut open = schemas.to_vec();
    let mut resolved = Vec::new();
    while let Some(schema) = open.pop() {
        if let Some(name) = schema["$ref"].as_str().and_then(|text| text.strip_prefix("#/$defs/")) {
            open.push(&root["$defs"][name]);
        }
        for choice in ["anyOf", "oneOf"] {
            open.extend(schema[choice].as_array().into_iter().flatten());
        }
        resolved.push(schema);
    }
    resolved
}

/// Returns all keys that a schema has anywhere.
pub fn all_keys(schema: &Value) -> BTreeSet<String> {
    let mut keys = BTreeSet::new();
    collect(schema, &mut keys);
    keys
}

fn collect(value: &Value, keys: &mut BTreeSet<String>) {
    match value {
        Value::Object(table) => {
            if let Some(Value::Object(properties)) = table.get("properties") {
                keys.extend(properties.keys().cloned());
            }
            table.values().for_each(|value| collect(value, keys));
        }
        Value::Array(items) => items.iter().for_each(|item| collect(item, keys)),
        _ => {}
    }
}
