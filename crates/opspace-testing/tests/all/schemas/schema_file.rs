//! A schema file, and the parts of it that apply to a value.

use jsonschema::Validator;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Step of a path to a value in a file.
#[derive(Clone, Debug)]
pub enum Step {
    Key(String),
    Element(usize),
}

/// Schema of a kind of file.
pub struct SchemaFile {
    schema: Value,
    validator: Validator,
}

impl SchemaFile {
    /// Reads a schema.
    pub fn read(path: &Path) -> Self {
        let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let schema = serde_json::from_str(&text).expect("JSON");
        let validator = jsonschema::validator_for(&schema).expect("a schema");
        Self { schema, validator }
    }

    /// True if the schema allows the contents of a file.
    pub fn accepts(&self, file: &toml::Table) -> bool {
        self.validator.is_valid(&serde_json::to_value(file).expect("JSON"))
    }

    /// Schemas of the whole file.
    pub fn whole(&self) -> Vec<&Value> {
        self.parts(&self.schema)
    }

    /// Schemas of a value within a value with these schemas.
    pub fn within<'a>(&'a self, schemas: &[&'a Value], step: &Step) -> Vec<&'a Value> {
        let inner = |schema: &&'a Value| match step {
            Step::Key(key) => match &schema["properties"][key] {
                Value::Null => &schema["additionalProperties"],
                property => property,
            },
            Step::Element(_) => &schema["items"],
        };
        schemas.iter().map(inner).flat_map(|schema| self.parts(schema)).collect()
    }

    /// Keys of all tables that are not required, with their schemas. Axes and other places within a value have no name.
    pub fn optional_keys(&self) -> impl Iterator<Item = (String, &Value)> {
        let definitions = self.schema["$defs"].as_object().expect("definitions");
        let tables =
            definitions.iter().map(|(name, table)| (name.as_str(), table)).chain([("", &self.schema)]);
        let tables =
            tables.flat_map(|(name, table)| self.parts(table).into_iter().map(move |part| (name, part)));
        tables.flat_map(|(name, table)| {
            let required = |key: &String| {
                table["required"].as_array().is_some_and(|keys| keys.contains(&Value::from(key.as_str())))
            };
            let keys = table["properties"].as_object().into_iter().flatten();
            keys.filter(move |(key, _)| !required(key)).map(move |(key, of)| (format!("{name}.{key}"), of))
        })
    }

    /// The schema, those that it refers to, and its alternatives.
    fn parts<'a>(&'a self, schema: &'a Value) -> Vec<&'a Value> {
        let name = schema["$ref"].as_str().and_then(|reference| reference.strip_prefix("#/$defs/"));
        let named = name.map(|name| &self.schema["$defs"][name]);
        let alternatives = ["anyOf", "oneOf"].into_iter().flat_map(|key| schema[key].as_array()).flatten();
        let further = named.into_iter().chain(alternatives).flat_map(|part| self.parts(part));
        [schema].into_iter().chain(further).collect()
    }
}

/// True if a property may have no value: an `Option`.
pub fn is_nullable(schema: &Value) -> bool {
    let alternatives = schema["anyOf"].as_array().into_iter().flatten();
    schema["type"].as_array().is_some_and(|types| types.iter().any(|kind| kind == "null"))
        || schema["enum"].as_array().is_some_and(|values| values.contains(&Value::Null))
        || alternatives.into_iter().any(|part| part["type"] == "null")
}
