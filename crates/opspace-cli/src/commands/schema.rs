//! `opspace schema`: JSON Schemas for editors, and pages of all keys.

use crate::cli::{SchemaArgs, SchemaKind};
use crate::console::{Exit, Outcome, print_exactly};
use crate::key_page::key_page;
use crate::output::pretty;
use crate::schema_defaults::add_empty_defaults;
use opspace_experiment::files::experiment_file::ExperimentFile;
use opspace_experiment::files::robot::RobotFile;
use opspace_experiment::files::task::TaskFile;
use opspace_experiment::metrics::columns::column_schema;
use opspace_experiment::suites::suite::SuiteFile;
use opspace_experiment::{Entry, Extensions, TaskKind, TransformerEntry};
use schemars::schema_for;
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
        SchemaKind::Task => schema_for!(TaskFile),
        SchemaKind::Suite => schema_for!(SuiteFile),
        SchemaKind::Experiment => schema_for!(ExperimentFile),
    };
    let mut schema = schema.to_value();
    if let Some(transformer) = schema.pointer_mut("/$defs/TransformerName") {
        transformer["enum"] = extensions.names::<TransformerEntry>().collect();
    }
    add_empty_defaults(&mut schema);
    add_extensions(&mut schema, extensions);
    schema
}

/// Adds the names of task kinds and columns that are not built in. The keys of such a task are known to its program alone.
fn add_extensions(schema: &mut Value, extensions: &Extensions) {
    let Some(definitions) = schema["$defs"].as_object_mut() else { return };
    if let Some(column) = definitions.get_mut("ColumnName") {
        *column = column_schema(extensions.added()).to_value();
    }
    if let Some(Value::Array(kinds)) =
        definitions.get_mut("TaskParameters").and_then(|task| task.get_mut("oneOf"))
    {
        kinds.extend(extensions.added::<TaskKind>().iter().map(|kind| {
            json!({
                "description": "A task of a kind that the program has added.",
                "type": "object",
                "properties": { kind.name(): { "type": "object" } },
                "additionalProperties": false,
                "required": [kind.name()],
            })
        }));
    }
}

/// Returns the page of all keys of a kind of file.
fn markdown(kind: SchemaKind, extensions: &Extensions) -> String {
    let (title, name) = match kind {
        SchemaKind::Robot => ("Keys of robot.toml", "robot"),
        SchemaKind::Task => ("Keys of a task file", "task"),
        SchemaKind::Suite => ("Keys of a suite file", "suite"),
        SchemaKind::Experiment => ("Keys of an experiment file", "experiment"),
    };
    key_page(&of(kind, extensions), title, &format!("opspace schema {name} --markdown"))
}
