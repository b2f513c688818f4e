//! Handlings of singularities that exist for comparisons and can damage a real robot.

use crate::codes::{COMPARISONS, Code};
use crate::files::source::FileError;
use crate::files::task::TaskDefinition;
use opspace_control::{SingularityHandling, TaskParameters};

/// Key of the first handling of singularities that exists only for comparisons, if there is one.
pub(super) fn comparison_only(task: &TaskDefinition) -> Option<[String; 4]> {
    let events = task.events.iter().map(|event| &event.task);
    let mut tasks = std::iter::once(&task.file.task).chain(events).flatten();
    tasks.find_map(|(name, task)| match task {
        TaskParameters::Cartesian(task) if task.singularities != SingularityHandling::Damped => {
            Some(["task", name, "cartesian", "singularities"].map(str::to_owned))
        }
        _ => None,
    })
}

/// Refuses handlings of singularities that exist only for comparisons.
pub(super) fn refuse_comparisons(task: &TaskDefinition) -> Result<(), FileError> {
    let Some(key) = comparison_only(task) else { return Ok(()) };
    let message = "this handling of singularities is only for comparisons, which this program does not have";
    let help = Some(format!("omit it, or use \"damped\"; those for comparisons in simulation {COMPARISONS}"));
    Err(FileError::at_key(&task.source, key, message, help).refused(Code::ComparisonOnly))
}
