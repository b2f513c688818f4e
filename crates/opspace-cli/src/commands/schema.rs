//! `opspace schema`: JSON Schemas for editors, and pages of all keys.

use crate::cli::{SchemaArgs, SchemaKind};
use crate::console::{Exit, Outcome, print_exactly};
use crate::key_page::key_page;
use crate::output::pretty;
use crate::schema_defaults::add_empty_defaults;
use opspace_backend::{Driver, DriverKey};
use opspace_control::TaskParameters;
use opspace_experiment::files::experiment_file::ExperimentFile;
use opspace_experiment::files::robot::RobotFile;
use opspace_experiment::files::task::TaskFile;
use opspace_experiment::metrics::columns::column_schema;
use opspace_experiment::{Entry, Extensions, TaskKind, TransformerEntry};
use opspace_suite::suite::SuiteFile;
use schemars::{Schema, SchemaGenerator, schema_for};
use serde_json::{Value, json};

pub fn schema(args: &SchemaArgs, extensions: &Extensions) -> Outcome {
    let text = if args.markdown { markdown(args.kind, extensions) } else { text(args.kind, extensions) };
    print_exactly(&text)?;
    Ok(Exit::Done)
}

/// Returns the schema of a kind of file.
pub fn text(kind: SchemaKind, extensions: &Extensions) -> String {
    pretty(&of(kind, extensions))
}

fn of(kind: SchemaKind, extensions: &Extensions) -> Value {
    let schema = match kind {
        SchemaKind::Robot => schema_for!(RobotFile),
        SchemaKind::Task => return task(extensions),
        SchemaKind::Suite => schema_for!(SuiteFile),
        SchemaKind::Experiment => schema_for!(ExperimentFile),
    };
    finished(schema.to_value(), extensions)
}

/// Returns the schema of a task file, with all kinds of tasks. Without a schema, the keys of a kind are known to its program alone.
fn task(extensions: &Extensions) -> Value {
    let mut generator = SchemaGenerator::default();
    let mut schema = generator.root_schema_for::<TaskFile>().to_value();
    let beside: Vec<Value> = extensions
        .all::<TaskKind>()
        .filter(|kind| !TaskParameters::KINDS.contains(&kind.name()))
        .map(|kind| {
            let table =
                kind.schema(&mut generator).map_or_else(|| json!({ "type": "object" }), Schema::to_value);
            let definition = table["$ref"].as_str().and_then(|path| path.rsplit('/').next());
            let definition = definition.and_then(|name| generator.definitions().get(name));
            let described = definition.and_then(|definition| definition["description"].as_str());
            let described = described.unwrap_or("A task of a kind that the program has added.");
            json!({
                "type": "object",
                "properties": { kind.name(): table },
                "required": [kind.name()],
                "additionalProperties": false,
                "description": described,
            })
        })
        .collect();
    if let Some(Value::Array(kinds)) = schema.pointer_mut("/$defs/TaskParameters/oneOf") {
        kinds.extend(beside);
    }
    if let Some(Value::Object(definitions)) = schema.get_mut("$defs") {
        for (name, definition) in generator.take_definitions(true) {
            definitions.entry(name).or_insert(definition);
        }
    }
    finished(schema, extensions)
}

fn finished(mut schema: Value, extensions: &Extensions) -> Value {
    if let Some(transformer) = schema.pointer_mut("/$defs/TransformerName") {
        transformer["enum"] = extensions.names::<TransformerEntry>().collect();
    }
    add_empty_defaults(&mut schema);
    if let Some(column) = schema.pointer_mut("/$defs/ColumnName") {
        *column = column_schema(extensions.added()).to_value();
    }
    schema
}

/// Returns the page of all keys of a kind of file.
fn markdown(kind: SchemaKind, extensions: &Extensions) -> String {
    let (title, name) = match kind {
        SchemaKind::Robot => ("Keys of robot.toml", "robot"),
        SchemaKind::Task => ("Keys of a task file", "task"),
        SchemaKind::Suite => ("Keys of a suite file", "suite"),
        SchemaKind::Experiment => ("Keys of an experiment file", "experiment"),
    };
    let page = key_page(&of(kind, extensions), title, &format!("opspace schema {name} --markdown"));
    match kind {
        SchemaKind::Robot => page + &extensions.drivers().map(driver_keys).collect::<String>(),
        _ => page,
    }
}

/// Returns the section with the keys of a driver; empty if it does not declare them.
fn driver_keys(driver: &dyn Driver) -> String {
    if driver.keys().is_empty() {
        return String::new();
    }
    let name = driver.name();
    let rows: String = driver.keys().iter().map(driver_key).collect();
    format!(
        "\n## Keys of the driver `{name}`\n\nKeys of `[driver]` beside `name = \"{name}\"`.\n\n| key | value | default | meaning \
         |\n|---|---|---|---|\n{rows}"
    )
}

fn driver_key(key: &DriverKey) -> String {
    let default = if key.is_required { "required" } else { key.default };
    format!("| `{}` | {} | {default} | {} |\n", key.name, key.value.words(), key.meaning.replace('|', "\\|"))
}
