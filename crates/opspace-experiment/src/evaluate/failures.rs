//! Failures that no single metric shows: a run that ended as planned and still missed the purpose of its task.

use crate::codes::Code;
use crate::finding::{Finding, Place};
use crate::metrics::metric_tables::Evaluation;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{self, PHASE, REFERENCE, TICK_CHANNEL};
use opspace_control::TaskParameters;
use opspace_log::Recording;
use opspace_loop::Phase;
use std::ops::Range;

/// Largest fraction of missed cycles of a run that is worth its numbers.
const MAX_MISSED: f64 = 0.1;

/// Smallest change of a joint's reference that must move the joint, rad or m.
const MIN_CHANGE: f64 = 0.01;

/// Smallest ratio of the motion of a joint to that of its reference: below it the joint is held.
const MIN_MOTION: f64 = 0.1;

/// Describes the failures of a run. Tasks in `untouched` were to press on something and never touched anything; joints of the tasks in
/// `unreached` are not held by friction.
pub(super) fn failures(
    evaluation: &Evaluation,
    untouched: Vec<String>,
    held: &HeldJoints,
    unreached: &[Finding],
) -> Vec<Finding> {
    let mut failures = Vec::new();
    for name in untouched {
        let message = format!("task '{name}' never touched anything, although it controls a force");
        failures.push(Finding::of(Code::NeverTouched, Place::Task(name), message));
    }
    for (name, task) in &evaluation.tasks {
        let contact = &task.contact;
        if contact.in_contact_fraction == Some(0.0) && contact.contact_begin_s.is_some() {
            let message = format!("task '{name}' lost contact before settle_s, and never touched again");
            failures.push(Finding::of(Code::ContactLost, Place::Task(name.clone()), message));
        }
    }
    if let Some(missed) = evaluation.metrics.missed_fraction.filter(|missed| *missed > MAX_MISSED) {
        let message = format!("{:.0} % of the interface cycles were missed", 100.0 * missed);
        let finding = Finding::of(Code::CyclesMissed, Place::Run(()), message);
        failures.push(finding.with("missed_fraction", Some(missed)));
    }
    let held = held.names(unreached);
    if !held.is_empty() {
        let message = format!(
            "the reference moves, but not {}: friction or a brake may hold it",
            held.iter().map(|joint| format!("joint '{joint}'")).collect::<Vec<_>>().join(", ")
        );
        let joints = held.iter().map(|&joint| joint.to_owned()).collect();
        failures.push(Finding::of(Code::JointsHeld, Place::Joints(joints), message));
    }
    failures
}

/// Ranges of the joints of joint tasks and of their references, over a whole log.
pub(super) struct HeldJoints {
    joints: Vec<JointRanges>,
    /// Names of the signals of references, each with the joints of its task; `None` for all.
    references: Vec<(String, Option<Vec<String>>)>,
}

/// Range of a joint, and of its reference in one task.
struct JointRanges {
    reference: String,
    joint: String,
    asked: Option<Range<f64>>,
    moved: Option<Range<f64>>,
}

impl HeldJoints {
    pub(super) fn new(experiment: &Experiment) -> Self {
        let tasks = experiment.task().tasks_of_the_run();
        let references = tasks.into_iter().filter_map(|(name, task)| match task {
            TaskParameters::JointTracking(task) => {
                Some((signal_names::of(name, REFERENCE), task.joints.clone()))
            }
            _ => None,
        });
        Self { joints: Vec::new(), references: references.collect() }
    }

    pub(super) fn add(&mut self, segment: &Recording) {
        let Some(tick) = segment.channel(TICK_CHANNEL) else { return };
        let (Some(q), Some(phase)) = (tick.signal(signal_names::Q), tick.signal(PHASE)) else { return };
        // Before control, references are not set.
        let controlled = || (0..tick.len()).filter(|&k| phase.row(k)[0] != Phase::Rest.code());
        for (signal, joints) in &self.references {
            let Some(reference) = tick.signal(signal) else { continue };
            for (place, joint) in reference.elements().iter().enumerate() {
                // The log has references of all joints, also of those that the task does not control.
                if joints.as_ref().is_some_and(|joints| !joints.contains(joint)) {
                    continue;
                }
                let Some(j) = q.elements().iter().position(|name| name == joint) else { continue };
                let known = self.joints.iter().position(|r| r.joint == *joint && r.reference == *signal);
                let known = known.unwrap_or_else(|| {
                    let (reference, joint) = (signal.clone(), joint.clone());
                    self.joints.push(JointRanges { reference, joint, asked: None, moved: None });
                    self.joints.len() - 1
                });
                let ranges = &mut self.joints[known];
                for k in controlled() {
                    widen(&mut ranges.asked, reference.row(k)[place]);
                    widen(&mut ranges.moved, q.row(k)[j]);
                }
            }
        }
    }

    /// Joints that hardly move although their reference does, except those of the tasks in `unreached`.
    fn names(&self, unreached: &[Finding]) -> Vec<&str> {
        let explained: Vec<String> =
            unreached.iter().filter_map(|goal| Some(signal_names::of(goal.task()?, REFERENCE))).collect();
        let is_held = |ranges: &&JointRanges| {
            let (asked, moved) = (width(ranges.asked.as_ref()), width(ranges.moved.as_ref()));
            asked > MIN_CHANGE && moved < MIN_MOTION * asked
        };
        let mut names: Vec<&str> = Vec::new();
        let unexplained = self.joints.iter().filter(|ranges| !explained.contains(&ranges.reference));
        for ranges in unexplained.filter(is_held) {
            if !names.contains(&ranges.joint.as_str()) {
                names.push(&ranges.joint);
            }
        }
        names
    }
}

/// Widens a range so that it contains a value, if the value is finite.
fn widen(range: &mut Option<Range<f64>>, value: f64) {
    if value.is_finite() {
        let before = range.take().unwrap_or(value..value);
        *range = Some(before.start.min(value)..before.end.max(value));
    }
}

/// Width of a range; 0 without one.
fn width(range: Option<&Range<f64>>) -> f64 {
    range.map_or(0.0, |range| range.end - range.start)
}
