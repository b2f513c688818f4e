//! Events and references that end after the run, and statistics that begin too early.

use super::case::{ActiveTasks, PreflightCase};
use super::diagnostic::{at_least, at_most, distinct, short};
use opspace_control::{
    BuildTask, CartesianReference, JointReference, ScalarReference, TaskParameters, TaskReference,
};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::rollout::Rollout;
use std::fmt;

/// Largest difference between two durations that count as equal, s.
const ROUNDING_S: f64 = 1e-6;

/// Speed below which a reference counts as at rest, m/s or rad/s.
const STANDING: f64 = 1e-4;

pub(crate) fn too_short(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let mut found = late_events(case);
    found.extend(settling(case));
    found.extend(unfinished(case, followed));
    found
}

/// Finds events after the end of the run.
fn late_events(case: &PreflightCase<'_>) -> Vec<Finding> {
    let duration_s = case.experiment.duration_s();
    let events = case.experiment.task().events.iter().enumerate();
    let late = events.filter(|(_, event)| event.time_s >= duration_s);
    late.map(|(number, event)| {
        let message = format!(
            "the event at {} s does not occur: the run ends at {} s",
            short(event.time_s),
            short(duration_s)
        );
        let help = format!("set its time below {} s, or increase duration_s", at_most(duration_s));
        Finding::new(Code::LateEvent, &["event", &number.to_string(), "time_s"], message, help)
    })
    .collect()
}

/// Reports a `settle_s` that ends before the torque ramp.
fn settling(case: &PreflightCase<'_>) -> Option<Finding> {
    let settle_s = case.experiment.task().file.settle_s.get();
    let ramp_s = case.experiment.robot().file.safety.torque_ramp_s.get();
    if settle_s >= ramp_s {
        return None;
    }
    let message = format!(
        "statistics start at {} s, but the torque ramps in over the first {} s",
        short(settle_s),
        short(ramp_s)
    );
    Some(Finding::new(
        Code::EarlyStatistics,
        &["settle_s"],
        message,
        format!("settle_s = {}", at_least(ramp_s)),
    ))
}

/// Finds references that still move at the end of the run.
fn unfinished(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let duration_s = case.experiment.duration_s();
    let last = case.task_sets.len() - 1;
    let stack = &case.task_sets[last];
    let unfinished = stack.priority.iter().filter_map(|name| {
        let task = stack.task.get(name)?;
        let same = |other: &ActiveTasks<'_>| {
            other.priority.contains(name) && other.task.get(name).and_then(BuildTask::reference) == task.reference()
        };
        let begin_s = case.begin_s(last, same);
        let message = match length_s(task)? {
            Length::Known(length_s) if begin_s + length_s > duration_s + ROUNDING_S => {
                let [arrives, ends] = distinct([begin_s + length_s, duration_s]);
                format!("task '{name}': its reference arrives at {arrives} s, but the run ends at {ends} s")
            }
            Length::Known(_) => return None,
            Length::AsFastAsItCan => {
                let (speed, unit) = speed_at_end(stack, followed, name)?;
                format!(
                    "task '{name}': its reference has not arrived when the run ends at {} s: it still moves at {} {unit}",
                    short(duration_s),
                    short(speed)
                )
            }
        };
        let help = match length_s(task)? {
            Length::Known(length_s) => {
                format!("duration_s = {}, or make the motion faster", at_least(begin_s + length_s))
            }
            Length::AsFastAsItCan => "increase duration_s, or the limits of the goal's motion".to_owned(),
        };
        Some(Finding::new(Code::UnfinishedReference, &["duration_s"], message, help))
    });
    unfinished.collect()
}

/// Duration of a path that a task follows.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PathDuration {
    /// Name of the task.
    pub task: String,
    /// Length of the path, m.
    pub length_m: f64,
    /// Duration of the motion along the path, s.
    pub duration_s: f64,
    /// True if a motion to the start of the path comes before, whose duration is not included.
    pub has_approach: bool,
    /// True if the path is as fast as its limits permit.
    pub time_optimal: bool,
}

impl fmt::Display for PathDuration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { task, length_m, duration_s, .. } = self;
        write!(f, "task '{task}': its path of {} m takes {} s", short(*length_m), short(*duration_s))?;
        if self.time_optimal {
            write!(f, ", time-optimal")?;
        }
        if self.has_approach { write!(f, ", after the motion to its start") } else { Ok(()) }
    }
}

/// Durations of the paths of all tasks, each task once for each of its paths.
pub(super) fn path_durations_of(experiment: &Experiment) -> Vec<PathDuration> {
    let mut found: Vec<PathDuration> = Vec::new();
    let file = &experiment.task().file;
    let events = experiment.task().events.iter().map(|event| (&event.priority, &event.task));
    for (priority, tasks) in std::iter::once((&file.priority, &file.task)).chain(events) {
        for name in priority {
            let Some(TaskReference::Cartesian(CartesianReference::Path(path))) =
                tasks.get(name).and_then(BuildTask::reference)
            else {
                continue;
            };
            let Ok(summary) = path.summary() else { continue };
            let new = PathDuration {
                task: name.clone(),
                length_m: summary.length_m,
                duration_s: summary.duration_s,
                has_approach: path.start.is_some(),
                time_optimal: path.time_optimal,
            };
            if !found.contains(&new) {
                found.push(new);
            }
        }
    }
    found
}

/// Duration of a motion.
enum Length {
    /// Duration, s.
    Known(f64),
    AsFastAsItCan,
}

/// Duration of a task's reference; `None` if it does not end.
fn length_s(task: &TaskParameters) -> Option<Length> {
    let known = |length_s: f64| Some(Length::Known(length_s));
    match task.reference()? {
        TaskReference::Cartesian(CartesianReference::PointToPoint(p)) => {
            known(p.start_s.get() + p.duration_s.get())
        }
        TaskReference::Cartesian(CartesianReference::Waypoints(list)) => known(list.last()?.time_s.get()),
        TaskReference::Cartesian(CartesianReference::Recorded(path)) => {
            known(path.samples.last()?.time_s - path.samples.first()?.time_s)
        }
        // The approach of a path in world coordinates takes a time of its own.
        TaskReference::Cartesian(CartesianReference::Path(path)) if path.start.is_some() => {
            Some(Length::AsFastAsItCan)
        }
        TaskReference::Cartesian(CartesianReference::Path(path)) => known(path.summary().ok()?.duration_s),
        TaskReference::Joint(JointReference::PointToPoint(p)) => known(p.start_s.get() + p.duration_s.get()),
        TaskReference::Joint(JointReference::Waypoints(list)) => known(list.last()?.time_s.get()),
        TaskReference::Scalar(ScalarReference::PointToPoint(p)) => {
            known(p.start_s.get() + p.duration_s.get())
        }
        TaskReference::Cartesian(CartesianReference::Goal(_))
        | TaskReference::Joint(JointReference::Goal(_))
        | TaskReference::Scalar(ScalarReference::Goal(_)) => Some(Length::AsFastAsItCan),
        TaskReference::Cartesian(
            CartesianReference::Hold | CartesianReference::Sinusoid(_) | CartesianReference::Streamed(_),
        )
        | TaskReference::Joint(
            JointReference::Hold | JointReference::Sinusoid(_) | JointReference::Streamed(_),
        )
        | TaskReference::Scalar(ScalarReference::Hold | ScalarReference::Sinusoid(_)) => None,
    }
}

/// Speed of a task's reference at the end of the run, with its unit; `None` if it is at rest.
fn speed_at_end(stack: &ActiveTasks<'_>, followed: &Rollout, name: &str) -> Option<(f64, &'static str)> {
    let end = followed.instants.last().filter(|_| followed.to_the_end)?;
    let place = stack.tasks.tasks().position(|task| task.name() == name);
    let (speed, unit) = match place.and_then(|place| end.tasks.get(place)) {
        Some(asked) => {
            let [linear, angular] = asked.speeds.map(|speed| speed.unwrap_or(0.0));
            if linear > STANDING { (linear, "m/s") } else { (angular, "rad/s") }
        }
        None => {
            let targets = end.joints.get(name)?;
            (targets.iter().fold(0.0, |most: f64, target| most.max(target.velocity.abs())), "rad/s")
        }
    };
    (speed > STANDING).then_some((speed, unit))
}
