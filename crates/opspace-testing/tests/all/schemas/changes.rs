//! Changes of a file, each of a single key.

use crate::schemas::schema_file::{SchemaFile, Step, is_nullable};
use std::collections::HashSet;
use toml::{Table, Value};

/// A change of a file.
#[derive(Clone)]
pub struct Change {
    /// Edits: one, after those that state a default.
    edits: Vec<Edit>,
    /// True if the value is the default of the key, so that the file means the same.
    pub is_default: bool,
}

/// Edit of one value.
#[derive(Clone)]
struct Edit {
    path: Vec<Step>,
    /// The value afterwards; `None` if the key is removed.
    value: Option<Value>,
}

/// Collects the changes of files with one schema.
pub struct Changes<'a> {
    schema: &'a SchemaFile,
    /// Defaults that a change has stated: once in all files is enough.
    stated: HashSet<*const serde_json::Value>,
    /// Edits that state the default within which changes are collected.
    before: Vec<Edit>,
    changes: Vec<Change>,
}

impl<'a> Changes<'a> {
    pub fn new(schema: &'a SchemaFile) -> Self {
        Self { schema, stated: HashSet::new(), before: Vec::new(), changes: Vec::new() }
    }

    /// Changes of all values of a file.
    pub fn of(&mut self, file: &Table) -> Vec<Change> {
        self.below(&Value::Table(file.clone()), &self.schema.whole(), &[]);
        std::mem::take(&mut self.changes)
    }

    fn add(&mut self, path: &[Step], last: Step, value: Option<Value>, is_default: bool) {
        let edit = Edit { path: [path, &[last]].concat(), value };
        self.changes.push(Change { edits: [&self.before[..], &[edit]].concat(), is_default });
    }

    /// Adds the changes of what is in a value with these schemas.
    fn below(&mut self, value: &Value, schemas: &[&'a serde_json::Value], path: &[Step]) {
        match value {
            Value::Table(table) => {
                self.add(path, Step::Key("no_such_key".to_owned()), Some(1.into()), false);
                for (name, value) in table {
                    let key = Step::Key(name.clone());
                    self.add(path, key.clone(), None, false);
                    self.values(value, schemas, path, key);
                }
                self.defaults(table, schemas, path);
            }
            Value::Array(values) => {
                for (index, value) in values.iter().enumerate() {
                    self.values(value, schemas, path, Step::Element(index));
                }
            }
            _ => {}
        }
    }

    /// Adds the changes of a value and of what is in it. The schemas are those of the table or list around it.
    fn values(&mut self, value: &Value, around: &[&'a serde_json::Value], path: &[Step], step: Step) {
        let schemas = self.schema.within(around, &step);
        for other in others(value).into_iter().chain(at_bounds(value, &schemas)) {
            if other != *value {
                self.add(path, step.clone(), Some(other), false);
            }
        }
        self.below(value, &schemas, &[path, &[step]].concat());
    }

    /// Adds each key that is absent, with its default and then with other values.
    fn defaults(&mut self, table: &Table, schemas: &[&'a serde_json::Value], path: &[Step]) {
        let properties = schemas.iter().filter_map(|schema| schema["properties"].as_object()).flatten();
        for (name, schema) in properties.filter(|(name, _)| !table.contains_key(*name)) {
            let default = schema.get("default").and_then(|default| Value::try_from(default).ok());
            let Some(default) = default.filter(|_| self.stated.insert(schema)) else { continue };
            let key = Step::Key(name.clone());
            self.add(path, key.clone(), Some(default.clone()), !is_nullable(schema));
            let edit =
                Edit { path: [path, std::slice::from_ref(&key)].concat(), value: Some(default.clone()) };
            self.before.push(edit);
            self.values(&default, schemas, path, key);
            self.before.pop();
        }
    }
}

impl Change {
    /// Returns the file after the change.
    pub fn apply(&self, file: &Table) -> Table {
        let mut file = Value::Table(file.clone());
        self.edits.iter().for_each(|edit| edit.apply(&mut file));
        let Value::Table(file) = file else { unreachable!("a table") };
        file
    }

    /// The key and its value afterwards.
    pub fn describe(&self) -> String {
        let edits: Vec<String> = self.edits.iter().map(Edit::describe).collect();
        edits.join(", then ")
    }
}

impl Edit {
    fn apply(&self, file: &mut Value) {
        let (last, path) = self.path.split_last().expect("a key");
        let inner = path.iter().try_fold(file, |value, step| match step {
            Step::Key(key) => value.get_mut(key),
            Step::Element(index) => value.get_mut(index),
        });
        match (inner.expect("a value"), last, &self.value) {
            (Value::Table(table), Step::Key(key), Some(value)) => {
                drop(table.insert(key.clone(), value.clone()))
            }
            (Value::Table(table), Step::Key(key), None) => drop(table.remove(key)),
            (Value::Array(values), Step::Element(index), Some(value)) => values[*index] = value.clone(),
            other => panic!("{other:?}"),
        }
    }

    fn describe(&self) -> String {
        let parts = self.path.iter().map(|step| match step {
            Step::Key(key) => key.clone(),
            Step::Element(index) => index.to_string(),
        });
        let value = self.value.as_ref().map_or_else(|| "absent".to_owned(), ToString::to_string);
        format!("{} = {value}", parts.collect::<Vec<_>>().join("."))
    }
}

/// Values of another sign, size, text or type.
fn others(value: &Value) -> Vec<Value> {
    let (text, list) = (Value::from("no such text"), Value::Array(vec![value.clone()]));
    match value {
        Value::Float(number) => {
            let numbers = [-number, 0.0, 1e12, 1.5, 0.5].map(Value::Float);
            numbers.into_iter().chain([text, true.into(), list]).collect()
        }
        Value::Integer(number) => {
            let numbers = [-number, 0, 1_000_000_000, 2].map(Value::Integer);
            numbers.into_iter().chain([2.5.into(), text, true.into(), list]).collect()
        }
        Value::String(_) => vec![text, "".into(), 3.into(), true.into(), list],
        Value::Boolean(_) => vec![text, 1.into(), list],
        Value::Array(values) => {
            let (some, last) = (&values[..values.len().saturating_sub(1)], values.last());
            let more = values.iter().chain(last).cloned().collect();
            let lists = [some.to_vec(), more, Vec::new()].map(Value::Array);
            lists.into_iter().chain([text, 1.into(), true.into(), Table::new().into()]).collect()
        }
        Value::Table(_) => vec![text, 1.into(), Value::Array(Vec::new())],
        Value::Datetime(_) => Vec::new(),
    }
}

/// Numbers at the bounds that the schemas state, and beyond them.
fn at_bounds(value: &Value, schemas: &[&serde_json::Value]) -> Vec<Value> {
    let bounds = schemas.iter().flat_map(|schema| {
        let keys = ["minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"];
        keys.into_iter().filter_map(|key| schema[key].as_f64())
    });
    match value {
        Value::Float(_) => {
            bounds.flat_map(|bound| [bound - 1.0, bound, bound + 1.0]).map(Value::Float).collect()
        }
        Value::Integer(_) => bounds
            .flat_map(|bound| [bound - 1.0, bound, bound + 1.0])
            .map(|bound| Value::Integer(bound as i64))
            .collect(),
        _ => Vec::new(),
    }
}
