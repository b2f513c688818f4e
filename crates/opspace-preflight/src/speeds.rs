//! References that are faster than the joints or the speed limit of their task allow.

use super::case::PreflightCase;
use super::diagnostic::{at_least, distinct, short};
use opspace_control::TaskParameters;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::rollout::{Instant, Rollout};

/// Ratio of a speed to its limit up to which nothing is reported, because the excess may be rounding.
const TOLERANCE: f64 = 1.001;

/// Reports the joint whose required speed exceeds its limit most, if any.
pub(crate) fn of_joints(case: &PreflightCase<'_>, followed: &Rollout) -> Option<Finding> {
    let share = case.experiment.velocity_fraction();
    let (mut worst, mut most) = (None, TOLERANCE);
    for instant in &followed.instants {
        for (joint, dq) in instant.dq.iter().enumerate() {
            let of_allowed = dq.abs() / (share * case.model.joints()[joint].limits.velocity);
            if of_allowed > most {
                (worst, most) = (Some((instant, joint)), of_allowed);
            }
        }
    }
    let (instant, joint) = worst?;
    let key = key_of_fastest(case, instant)?;
    let limit = case.model.joints()[joint].limits.velocity;
    let [asked, allowed] = distinct([instant.dq[joint].abs(), share * limit]);
    let allowed = if share < 1.0 {
        format!("{allowed} rad/s, {} of its limit of {}", short(share), short(limit))
    } else {
        format!("{allowed} rad/s")
    };
    let message = format!(
        "at {} s the references move joint '{}' at {asked} rad/s; allowed: {allowed}",
        short(instant.time_s),
        case.joint(joint),
    );
    let help = format!("make the motion {} times as long, or smaller", at_least(most));
    Some(Finding::new(Code::JointTooFast, &key, message, help))
}

/// Key of the moving reference of highest priority.
pub(super) fn key_of_fastest(case: &PreflightCase<'_>, instant: &Instant) -> Option<Vec<String>> {
    let stack = &case.task_sets[instant.task_set];
    let moving = stack.tasks.tasks().zip(&instant.tasks).find(|(_, asked)| asked.velocity > 1e-6);
    let in_joints = || {
        let task = stack.tasks.joint_task()?;
        let targets = instant.joints.get(task.name())?;
        targets.iter().any(|target| target.velocity.abs() > 1e-6).then(|| task.name())
    };
    let name = moving.map(|(task, _)| task.name()).or_else(in_joints)?;
    Some(case.reference_key(instant.task_set, name))
}

/// Finds references that exceed the speed limit of their task.
pub(crate) fn of_tasks(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    for (number, stack) in case.task_sets.iter().enumerate() {
        for (place, task) in stack.tasks.tasks().enumerate() {
            for (which, key, unit) in
                [(0, "speed_limit_m_per_s", "m/s"), (1, "speed_limit_rad_per_s", "rad/s")]
            {
                let in_force = followed.instants.iter().filter(|instant| instant.task_set == number);
                let asked = in_force.filter_map(|instant| {
                    let asked = instant.tasks.get(place)?;
                    Some((asked.speeds[which]?, asked.speed_limits[which]?, instant.time_s))
                });
                let fastest = asked.max_by(|a, b| a.0.total_cmp(&b.0));
                let Some((asked, limit, time_s)) =
                    fastest.filter(|(asked, limit, _)| *asked > TOLERANCE * limit)
                else {
                    continue;
                };
                let message = format!(
                    "task '{}': at {} s its reference moves at {} {unit}, but {key} is {}: the task will lag behind",
                    task.name(),
                    short(time_s),
                    short(asked),
                    short(limit),
                );
                let help =
                    format!("make the motion {} times as long, or raise the limit", at_least(asked / limit));
                let kind = stack.task.get(task.name()).map_or("", TaskParameters::kind);
                let key = case.key(number, task.name(), &[kind, key]);
                // An event may leave the task unchanged: it is reported only once.
                let new = Finding::new(Code::ReferenceTooFast, &key, message, help);
                if !found.iter().any(|old| old.place == new.place) {
                    found.push(new);
                }
            }
        }
    }
    found
}
