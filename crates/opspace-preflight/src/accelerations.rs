//! References that need more acceleration of a joint than its limit, or more torque than the drive has.
//!
//! The accelerations are differences of the velocities of the rollout, and the torques those of the inverse dynamics there:
//! M q̈ + C q̇ + g, without friction.

use super::case::PreflightCase;
use super::diagnostic::{at_least, short};
use super::speeds::key_of_fastest;
use opspace_backend::GravityCompensation;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::rollout::{Instant, Rollout};
use opspace_model::{JointKind, kinematics, rnea};

/// Shortest and longest time between two velocities of which the difference is taken, s. A jump of a velocity counts as an
/// acceleration over the shortest one.
const LEAST_STEP_S: f64 = 0.01;
const MAX_STEP_S: f64 = 0.1;

/// Ratio of a demand to its limit up to which nothing is reported: friction and the differences are not exact.
const TOLERANCE: f64 = 1.05;

/// Largest demand of the references relative to a limit of a joint.
struct Worst<'a> {
    instant: &'a Instant,
    joint: usize,
    /// Demand and limit, rad/s² (m/s²) or Nm (N).
    asked: f64,
    limit: f64,
}

impl Worst<'_> {
    fn ratio(&self) -> f64 {
        self.asked / self.limit
    }
}

/// Reports the joint whose acceleration limit, and the one whose torque limit, the references exceed most.
pub(crate) fn of_joints(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let limits = case.experiment.task().file.limits;
    let share = if limits.enforce { limits.torque_fraction.get().min(1.0) } else { 1.0 };
    let of_robot = case.experiment.robot().joint_limits();
    let by_robot =
        case.experiment.robot().file.interface.gravity_compensated_by == GravityCompensation::Robot;
    let mut data = case.data.clone();
    let [mut fastest, mut heaviest]: [Option<Worst<'_>>; 2] = [None, None];
    let mut longer: f64 = 1.0;
    for (before, after) in pairs(&followed.instants) {
        let step_s = after.time_s - before.time_s;
        let ddq: Vec<f64> = before.dq.iter().zip(&after.dq).map(|(a, b)| (b - a) / step_s).collect();
        kinematics(case.model, &mut data, &before.q, &before.dq);
        rnea(case.model, &mut data, &ddq);
        for (joint, ddq) in ddq.iter().enumerate() {
            let gravity = before.gravity[joint];
            let torque = data.torque[joint] - if by_robot { gravity } else { 0.0 };
            let acceleration =
                Worst { instant: before, joint, asked: ddq.abs(), limit: of_robot.acceleration[joint] };
            let torque =
                Worst { instant: before, joint, asked: torque.abs(), limit: share * of_robot.torque[joint] };
            if limits.enforce {
                keep_larger(&mut fastest, acceleration);
            }
            // The weight alone is a diagnostic of its own.
            if by_robot || gravity.abs() <= torque.limit {
                longer = longer.max(times_as_long(
                    data.torque[joint] - gravity,
                    if by_robot { 0.0 } else { gravity },
                    torque.limit,
                ));
                keep_larger(&mut heaviest, torque);
            }
        }
    }
    let found = [
        fastest.and_then(|worst| acceleration(case, &worst)),
        heaviest.and_then(|worst| torque(case, &worst, longer)),
    ];
    found.into_iter().flatten().collect()
}

/// Pairs of instants of one task set that are a little apart.
pub(super) fn pairs(instants: &[Instant]) -> impl Iterator<Item = (&Instant, &Instant)> {
    let mut last = 0;
    instants.iter().enumerate().filter_map(move |(k, before)| {
        last = last.max(k);
        while instants.get(last).is_some_and(|after| after.time_s < before.time_s + LEAST_STEP_S - 1e-9) {
            last += 1;
        }
        let after = instants.get(last)?;
        let fits = after.task_set == before.task_set && after.time_s <= before.time_s + MAX_STEP_S;
        fits.then_some((before, after))
    })
}

fn keep_larger<'a>(worst: &mut Option<Worst<'a>>, new: Worst<'a>) {
    if new.ratio() > worst.as_ref().map_or(TOLERANCE, Worst::ratio) {
        *worst = Some(new);
    }
}

fn acceleration(case: &PreflightCase<'_>, worst: &Worst<'_>) -> Option<Finding> {
    let Worst { instant, joint, asked, limit } = *worst;
    let key = key_of_fastest(case, instant)?;
    let unit = if is_prismatic(case, joint) { "m/s²" } else { "rad/s²" };
    let message = format!(
        "at {} s the references accelerate joint '{}' by {} {unit}; its limit is {} {unit}",
        short(instant.time_s),
        case.joint(joint),
        short(asked),
        short(limit),
    );
    let help = format!("make the motion {} times as long, or smaller", at_least(worst.ratio().sqrt()));
    Some(Finding::new(Code::AccelerationAboveLimit, &key, message, help))
}

/// Factor of the time that a motion needs so that its torque without weight, which falls with the square of the time, fits
/// between the weight and the limit (Nm, N); 1 if it fits already.
fn times_as_long(moving: f64, weight: f64, limit: f64) -> f64 {
    let left = limit - moving.signum() * weight;
    (moving.abs() / left).sqrt().max(1.0)
}

fn torque(case: &PreflightCase<'_>, worst: &Worst<'_>, longer: f64) -> Option<Finding> {
    let Worst { instant, joint, asked, limit } = *worst;
    let key = key_of_fastest(case, instant)?;
    let unit = if is_prismatic(case, joint) { "N" } else { "Nm" };
    let message = format!(
        "at {} s the references need {} {unit} from joint '{}', without its friction; allowed: {} {unit}",
        short(instant.time_s),
        short(asked),
        case.joint(joint),
        short(limit),
    );
    let help = if longer.is_finite() {
        format!(
            "make the motion {} times as long, or smaller, or choose a posture with less weight on this joint",
            at_least(longer)
        )
    } else {
        "choose a posture with less weight on this joint".to_owned()
    };
    Some(Finding::new(Code::TorqueAboveLimit, &key, message, help))
}

fn is_prismatic(case: &PreflightCase<'_>, joint: usize) -> bool {
    case.model.joints()[joint].kind == JointKind::Prismatic
}
