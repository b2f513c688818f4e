//! Changes of an experiment, which are tried before a diagnostic proposes them.

use opspace_experiment::files::robot::RobotDefinition;
use opspace_experiment::files::task::TaskFile;
use opspace_experiment::run::experiment::{Experiment, RunOptions};
use opspace_transformer::TransformerName;

/// Transformers that a diagnostic may propose in place of the one in use, the best first: on elastic gears the extrapolation, then
/// that of the paper.
pub(super) fn other_transformers(experiment: &Experiment) -> Vec<TransformerName> {
    let used = experiment.transformer_name();
    let corrected = TransformerName::EXTRAPOLATION.with_current(true);
    let mut all = vec![TransformerName::EXTRAPOLATION, TransformerName::PAPER];
    if experiment.measures_current() {
        all.insert(0, corrected);
    }
    all.retain(|name| used.as_ref() != Some(name));
    all
}

/// Returns the experiment with another transformer; `None` if it cannot be built.
pub(super) fn with_transformer(experiment: &Experiment, name: &TransformerName) -> Option<Experiment> {
    let options = RunOptions { transformer: Some(name.clone()), ..experiment.options().clone() };
    experiment.with_parts(experiment.robot().clone(), experiment.task().clone(), options).ok()
}

/// Returns the experiment with a change of its task file; `None` if it cannot be built.
pub(super) fn with_task(experiment: &Experiment, change: impl FnOnce(&mut TaskFile)) -> Option<Experiment> {
    let mut task = experiment.task().clone();
    change(&mut task.file);
    experiment.with_parts(experiment.robot().clone(), task, experiment.options().clone()).ok()
}

/// Returns the experiment with a change of its robot; `None` if it cannot be built.
pub(super) fn with_robot(
    experiment: &Experiment,
    change: impl FnOnce(&mut RobotDefinition),
) -> Option<Experiment> {
    let mut robot = experiment.robot().clone();
    change(&mut robot);
    experiment.with_parts(robot, experiment.task().clone(), experiment.options().clone()).ok()
}

/// Joins alternatives: `a`, `a, or b`, `a, b, or c`.
pub(super) fn alternatives(all: &[String]) -> String {
    match all {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{}, or {last}", first.join(", ")),
    }
}
