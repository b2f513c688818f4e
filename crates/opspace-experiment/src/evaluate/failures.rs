//! Failures that no single metric shows: a run that ended as planned and still missed the purpose of its task.

use crate::evaluate::metrics::Evaluation;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{self, REFERENCE, TICK_CHANNEL};
use opspace_control::TaskParameters;
use opspace_log::Recording;

/// Largest fraction of missed cycles of a run that is worth its numbers.
const MAX_MISSED: f64 = 0.5;

/// Smallest change of a joint's reference that must move the joint, rad or m.
const MIN_CHANGE: f64 = 0.01;

/// Smallest ratio of the motion of a joint to that of its reference: below it the joint is held.
const MIN_MOTION: f64 = 0.1;

/// Describes the failures of a run.
pub(crate) fn failures(
    experiment: &Experiment,
    recording: &Recording,
    evaluation: &Evaluation,
) -> Vec<String> {
    let mut failures = Vec::new();
    for (name, task) in &evaluation.tasks {
        if task.contact.in_contact_fraction == Some(0.0) {
            failures.push(match task.contact.contact_begin_s {
                None => format!("task '{name}' never touched anything, although it controls a force"),
                Some(_) => format!("task '{name}' lost contact before settle_s, and never touched again"),
            });
        }
    }
    if let Some(missed) = evaluation.metrics.missed_fraction.filter(|missed| *missed > MAX_MISSED) {
        failures.push(format!("{:.0} % of the interface cycles were missed", 100.0 * missed));
    }
    let held = held_joints(experiment, recording);
    if !held.is_empty() {
        failures.push(format!(
            "the reference moves, but {} does not: friction or a brake may hold it",
            held.iter().map(|joint| format!("joint '{joint}'")).collect::<Vec<_>>().join(", ")
        ));
    }
    failures
}

/// Joints of joint tasks that hardly move although their reference does.
fn held_joints(experiment: &Experiment, recording: &Recording) -> Vec<String> {
    let Some(tick) = recording.channel(TICK_CHANNEL) else { return Vec::new() };
    let Some(q) = tick.signal(signal_names::Q) else { return Vec::new() };
    let mut held = Vec::new();
    let file = &experiment.task().file;
    for name in &file.priority {
        let Some(TaskParameters::JointTracking(task)) = file.task.get(name) else { continue };
        let Some(reference) = tick.signal(&signal_names::of(name, REFERENCE)) else { continue };
        for (place, joint) in reference.elements().iter().enumerate() {
            // The log has references of all joints, also of those that the task does not control.
            if task.joints.as_ref().is_some_and(|joints| !joints.contains(joint)) {
                continue;
            }
            let Some(j) = q.elements().iter().position(|name| name == joint) else { continue };
            let asked = range(reference.rows().map(|row| row[place]));
            let moved = range(q.rows().map(|row| row[j]));
            if asked > MIN_CHANGE && moved < MIN_MOTION * asked && !held.contains(joint) {
                held.push(joint.clone());
            }
        }
    }
    held
}

/// Difference of the largest and the smallest finite value; 0 without one.
fn range(values: impl Iterator<Item = f64>) -> f64 {
    let ends = values.filter(|value| value.is_finite()).fold(None, |ends: Option<(f64, f64)>, value| {
        Some(ends.map_or((value, value), |(low, high)| (low.min(value), high.max(value))))
    });
    ends.map_or(0.0, |(low, high)| high - low)
}
