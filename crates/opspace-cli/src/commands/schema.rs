//! `opspace schema`: JSON Schemas for editors.

use crate::cli::SchemaKind;
use crate::console::{Exit, Outcome, print_exactly};
use crate::output::pretty;
use opspace_experiment::files::experiment_file::ExperimentFile;
use opspace_experiment::files::robot::RobotFile;
use opspace_experiment::files::suite::SuiteFile;
use opspace_experiment::files::task::TaskFile;
use schemars::schema_for;

pub fn schema(kind: SchemaKind) -> Outcome {
    print_exactly(&text(kind))?;
    Ok(Exit::Done)
}

/// Returns the schema of a kind of file.
pub fn text(kind: SchemaKind) -> String {
    pretty(&match kind {
        SchemaKind::Robot => schema_for!(RobotFile),
        SchemaKind::Task => schema_for!(TaskFile),
        SchemaKind::Suite => schema_for!(SuiteFile),
        SchemaKind::Experiment => schema_for!(ExperimentFile),
    })
}
