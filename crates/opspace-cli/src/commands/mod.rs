//! Commands, one file each.

pub mod bench;
pub mod check;
pub mod completion;
pub mod explain;
pub mod export_path;
pub mod identify;
pub mod log;
pub mod margins;
pub mod merge;
pub mod model;
pub mod new;
pub mod posture;
pub mod replay;
pub mod report;
pub mod report_coupled;
pub mod run;
pub mod run_coupled;
pub mod run_on_log;
pub mod schema;

use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Extensions, Files};
use std::path::Path;

/// Returns the command interface declared in robot.toml.
fn own_backend(
    task: &Path,
    robot: Option<&Path>,
    settings: &[String],
    extensions: &Extensions,
) -> CommandKind {
    // Mistakes in the files are reported when the files are combined.
    Experiment::declared_command(extensions, Files::Disk, task, robot, settings)
        .unwrap_or(CommandKind::Position)
}
