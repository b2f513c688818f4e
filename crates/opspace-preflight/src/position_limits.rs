//! References that a task misses because the motion from the start leads joints to their position limits.
//!
//! A goal may be within reach, but only in postures to which the motion from the start posture does not lead. The joints
//! follow the references twice: without position limits, which shows the joints that would leave their ranges, and with
//! the limits, which shows whether the task misses its reference for that reason. A redundant arm often does not.

use super::case::PreflightCase;
use super::diagnostic::short;
use super::motion::Motion;
use nalgebra::Rotation3;
use opspace_control::{AxisMode, ControlledFrame};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::postures::posture_at::norm_in;
use opspace_experiment::run::rollout::{Instant, Rollout, RolloutCase};

/// Distance beyond the range of a joint that may be rounding, rad or m.
const ROUNDING: f64 = 1e-6;

/// Errors from which on a task counts as away from its reference, m and rad: those of the notes after a run.
const MISSED: [f64; 2] = [5e-3, 20e-3];

/// Reports the task that position limits keep farthest from its reference, if any.
pub(crate) fn beyond_on_the_way(case: &PreflightCase<'_>, followed: &Rollout) -> Option<Finding> {
    let leaves =
        |instant: &Instant| (0..case.model.n()).any(|joint| outside(case, joint, instant) > ROUNDING);
    if !followed.instants.iter().any(leaves) {
        return None;
    }
    let ranges = (0..case.model.n()).map(|joint| case.range(joint)).collect();
    let within = Rollout::new(&RolloutCase { ranges: Some(ranges), ..case.rollout() });
    let pairs: Vec<(&Instant, &Instant)> = followed.instants.iter().zip(&within.instants).collect();
    let misses = pairs.iter().flat_map(|(free, kept)| Miss::all(case, free, kept));
    let worst = misses.reduce(|worst, next| if next.ratio() > worst.ratio() { next } else { worst })?;
    let last = pairs.last().into_iter().flat_map(|(free, kept)| Miss::all(case, free, kept));
    let at_end = last.filter(|_| within.to_the_end).find(|miss| miss.name == worst.name);
    let (miss, is_at_end) = at_end.map_or((worst, false), |miss| (miss, true));

    // The joint at an end of its range that would have left it first.
    let stays = |joint: usize| {
        let (lower, upper) = case.range(joint);
        let q = miss.kept.q[joint];
        q <= lower + ROUNDING || q >= upper - ROUNDING
    };
    let before = || followed.instants.iter().take_while(|instant| instant.step <= miss.kept.step);
    let first = |is_candidate: &dyn Fn(usize) -> bool| {
        before().find_map(|instant| {
            let mut joints = (0..case.model.n()).filter(|&joint| is_candidate(joint));
            Some((joints.find(|&joint| outside(case, joint, instant) > ROUNDING)?, instant.time_s))
        })
    };
    let (joint, time_s) = first(&stays).or_else(|| first(&|_| true))?;
    let farthest = before().map(|instant| outside(case, joint, instant)).fold(0.0, f64::max);
    let is_upper = before().any(|instant| instant.q[joint] > case.range(joint).1 + ROUNDING);
    let limits = &case.model.joints()[joint].limits;
    let (limit, bound, end) = match is_upper {
        true => (limits.upper, case.range(joint).1, "upper"),
        false => (limits.lower, case.range(joint).0, "lower"),
    };
    let margin = if case.margin() > 0.0 {
        format!(" (its {end} limit of {} less position_margin_rad)", short(limit))
    } else {
        format!(" (its {end} limit)")
    };
    let message = format!(
        "task '{}': its reference leads joint '{}' from this start beyond {}{margin} at {} s, by up to {}: the joint stays \
         there, and the task {} about {} away from its reference",
        miss.name,
        case.joint(joint),
        short(bound),
        short(time_s),
        short(farthest),
        if is_at_end { "ends" } else { "gets" },
        miss.text(),
    );
    let key = case.reference_key(miss.kept.task_set, miss.name);
    Some(Finding::new(Code::LimitOnTheWay, &key, message, help(case, miss.kept.task_set, miss.name)))
}

/// Remedy for a task.
fn help(case: &PreflightCase<'_>, set: usize, name: &str) -> String {
    let motion = case.task_sets[set].motions.iter().find(|motion| motion.name == name);
    let posture = motion.and_then(|motion| pose_text(case, motion)).map_or_else(
        || "start in another posture (start_rad)".to_owned(),
        |at| {
            format!(
                "the goal itself can be reached: start in another posture, `opspace model {} {at}` finds the one at the same \
                 pose that is farthest from the limits",
                case.experiment.robot().source.name()
            )
        },
    );
    format!("{posture}; or make the motion smaller, or free an axis")
}

/// Options of `opspace model` for the pose of a task at the start; `None` for the centre of mass.
fn pose_text(case: &PreflightCase<'_>, motion: &Motion<'_>) -> Option<String> {
    let ControlledFrame::Frame(_) = motion.controlled else { return None };
    let pose = motion.controlled.placement(case.model, &case.data);
    let (roll, pitch, yaw) = Rotation3::from_matrix_unchecked(pose.rotation).euler_angles();
    let rotates = motion.parameters.axes.with_mode(AxisMode::Motion)[3..].contains(&true);
    let mut values: Vec<f64> = pose.translation.iter().copied().collect();
    values.extend([roll, pitch, yaw].into_iter().filter(|_| rotates));
    // Rounding errors of zero.
    let number = |value: &f64| if value.abs() < 1e-9 { "0".to_owned() } else { short(*value) };
    let values: Vec<String> = values.iter().map(number).collect();
    Some(format!("--frame {} --at={}", motion.parameters.frame, values.join(",")))
}

/// Distance of a joint from its range, rad or m; negative inside.
fn outside(case: &PreflightCase<'_>, joint: usize, instant: &Instant) -> f64 {
    let ((lower, upper), q) = (case.range(joint), instant.q[joint]);
    (lower - q).max(q - upper)
}

/// Task that misses its reference with position limits, and not without them.
struct Miss<'a> {
    name: &'a str,
    /// Instant with position limits.
    kept: &'a Instant,
    /// Errors with position limits, m and rad.
    by: [f64; 2],
}

impl<'a> Miss<'a> {
    /// Tasks that miss their references at an instant: `free` without position limits, `kept` with them.
    fn all(case: &'a PreflightCase<'_>, free: &Instant, kept: &'a Instant) -> Vec<Self> {
        let tasks = case.task_sets[kept.task_set].tasks.tasks();
        let errors = free.tasks.iter().zip(&kept.tasks);
        let misses = tasks.zip(errors).filter_map(|(task, (free, kept_task))| {
            let without = ["m", "rad"].map(|unit| norm_in(task, &free.error, unit));
            let by = ["m", "rad"].map(|unit| norm_in(task, &kept_task.error, unit));
            let is_missed = (0..2).any(|unit| by[unit] - without[unit] > MISSED[unit]);
            is_missed.then_some(Miss { name: task.name(), kept, by })
        });
        misses.collect()
    }

    /// Largest error relative to the one that counts.
    fn ratio(&self) -> f64 {
        self.by.iter().zip(MISSED).map(|(by, least)| by / least).fold(0.0, f64::max)
    }

    fn text(&self) -> String {
        let errors =
            self.by.iter().zip([1e-4, 1e-3]).zip(["mm", "mrad"]).filter(|((by, least), _)| *by > least);
        let texts: Vec<String> = errors.map(|((by, _), unit)| format!("{:.0} {unit}", 1e3 * by)).collect();
        texts.join(" and ")
    }
}
