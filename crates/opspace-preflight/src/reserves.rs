//! Joints that reach a limit first if a task gets heavier, presses harder, or moves faster.
//!
//! The torques are those of the inverse dynamics along the references, M q̈ + C q̇ + g, with the declared friction against them.
//! They are linear in the mass of a payload, and in the forces of the environment (Jᵀ F): of each the least multiple is computed
//! at which a joint reaches its torque limit. A target force whose multiple is below 1 is a diagnostic.

use super::accelerations::pairs;
use super::case::PreflightCase;
use super::diagnostic::{at_most, short};
use nalgebra::{Matrix6xX, Vector6};
use opspace_backend::GravityCompensation;
use opspace_control::{AXIS_NAMES, ControlledFrame};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::postures::tip::tip;
use opspace_experiment::run::rollout::{Instant, Rollout};
use opspace_model::{Data, FrameId, Inertia, Model, Placement, frame_jacobian, kinematics, rnea};
use std::fmt;

/// Multiples from which on nothing is said: the joint has no part in it.
const LARGEST: f64 = 1000.0;

/// Joint that reaches a limit first.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Reserve {
    /// Demand that grows until then.
    pub of: ReserveOf,
    /// Joint.
    pub joint: String,
    /// Size at which the joint reaches its limit: the mass of a payload, kg, or a multiple of target forces or of speeds.
    pub at: f64,
}

/// Demand that grows until a joint reaches its limit.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ReserveOf {
    /// Point mass in the origin of this frame, in addition to the declared tools.
    Payload(String),
    /// Target forces of the tasks.
    TargetForces,
    /// Speed of the references.
    Speed,
}

impl ReserveOf {
    /// Name in JSON.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Payload(_) => "payload_kg",
            Self::TargetForces => "target_forces",
            Self::Speed => "speed",
        }
    }
}

impl fmt::Display for Reserve {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (joint, at) = (&self.joint, short(self.at));
        match &self.of {
            ReserveOf::Payload(_) if self.at == 0.0 => {
                write!(f, "joint '{joint}' reaches its torque limit without a payload")
            }
            ReserveOf::Payload(frame) => {
                write!(
                    f,
                    "joint '{joint}' is the first at its torque limit with a payload: {at} kg at '{frame}'"
                )
            }
            ReserveOf::TargetForces => {
                write!(
                    f,
                    "joint '{joint}' is the first at its torque limit with force: {at} times the target forces"
                )
            }
            ReserveOf::Speed => {
                write!(
                    f,
                    "joint '{joint}' is the first at its speed limit: {at} times the speed of the references"
                )
            }
        }
    }
}

/// Least multiple of a demand at which a joint reaches its limit.
#[derive(Clone, Copy)]
struct Least {
    joint: usize,
    multiple: f64,
}

impl Least {
    const NONE: Self = Self { joint: 0, multiple: LARGEST };

    /// Adds a joint with the torque `taken` and its limit, and the torque `more` per unit.
    fn add(&mut self, joint: usize, taken: f64, limit: f64, more: f64) {
        if more != 0.0 {
            let multiple = ((limit - more.signum() * taken) / more.abs()).max(0.0);
            if multiple < self.multiple {
                *self = Self { joint, multiple };
            }
        }
    }

    fn reserve(self, case: &PreflightCase<'_>, of: ReserveOf) -> Option<Reserve> {
        let joint = || case.joint(self.joint).to_owned();
        (self.multiple < LARGEST).then(|| Reserve { of, joint: joint(), at: self.multiple })
    }
}

/// Returns the joints that reach a limit first.
pub(super) fn reserves_of(case: &PreflightCase<'_>) -> Vec<Reserve> {
    let followed = Rollout::new(&case.rollout());
    let Some(frame) = payload_frame(case) else { return Vec::new() };
    let torques = Torques::new(case, frame);
    let [payload, forces] = torques.along(case, &followed.instants);
    let name = case.model.frame(frame).name.clone();
    let all = [
        payload.reserve(case, ReserveOf::Payload(name)),
        forces.reserve(case, ReserveOf::TargetForces),
        speed(case, &followed.instants).reserve(case, ReserveOf::Speed),
    ];
    all.into_iter().flatten().collect()
}

/// Reports target forces that a joint cannot exert along the references, if there are any.
pub(super) fn forces_above_limits(case: &PreflightCase<'_>, followed: &Rollout) -> Option<Finding> {
    let (task_set, name, axis, target) = largest_target(case)?;
    let torques = Torques::new(case, payload_frame(case)?);
    let [_, forces] = torques.along(case, &followed.instants);
    // Without any force left, the weight or the motion is a diagnostic of its own.
    if forces.multiple >= 1.0 || forces.multiple == 0.0 {
        return None;
    }
    let (axis, unit) = (AXIS_NAMES[axis], if axis < 3 { "N" } else { "Nm" });
    let message = format!(
        "task '{name}' asks for {} {unit} along {axis}, but joint '{}' reaches its torque limit at {} {unit}",
        short(target),
        case.joint(forces.joint),
        at_most(forces.multiple * target),
    );
    let help = format!(
        "give at most {} {unit}, or choose a posture with a shorter lever at this joint",
        at_most(0.9 * forces.multiple * target)
    );
    let key = if unit == "N" { "target_n" } else { "target_nm" };
    Some(Finding::new(
        Code::ForceAboveLimit,
        &case.key(task_set, &name, &["cartesian", "force", key]),
        message,
        help,
    ))
}

/// Largest target force of all tasks (N, Nm) with its task set, task and axis; `None` without one.
fn largest_target(case: &PreflightCase<'_>) -> Option<(usize, String, usize, f64)> {
    let targets = case.task_sets.iter().enumerate().flat_map(|(number, set)| {
        set.motions.iter().flat_map(move |motion| {
            let target = motion.parameters.target_force();
            (0..6).map(move |axis| (number, motion.name.to_owned(), axis, target[axis].abs()))
        })
    });
    targets.filter(|(.., target)| *target > 0.0).max_by(|a, b| a.3.total_cmp(&b.3))
}

/// Frame of the first task, or the tip of the arm.
fn payload_frame(case: &PreflightCase<'_>) -> Option<FrameId> {
    let of_task = case.task_sets.first().and_then(|set| set.motions.first());
    let named = of_task.and_then(|motion| case.model.frame_id(&motion.parameters.frame).ok());
    named.or_else(|| tip(case.model))
}

fn speed(case: &PreflightCase<'_>, instants: &[Instant]) -> Least {
    let share = case.experiment.velocity_fraction();
    let mut least = Least::NONE;
    for instant in instants {
        for (joint, dq) in instant.dq.iter().enumerate() {
            least.add(joint, 0.0, share * case.model.joints()[joint].limits.velocity, *dq);
        }
    }
    least
}

/// Torques of the joints along references.
struct Torques {
    /// Robot with 1 kg more.
    loaded: Model,
    /// Limits (n; Nm, N).
    limits: Vec<f64>,
    /// Coulomb (Nm, N) and viscous friction (Nms/rad, Ns/m) of each joint.
    friction: Vec<[f64; 2]>,
    by_robot: bool,
}

impl Torques {
    fn new(case: &PreflightCase<'_>, frame: FrameId) -> Self {
        let robot = case.experiment.robot();
        let limits = case.experiment.task().file.limits;
        let share = if limits.enforce { limits.torque_fraction.get().min(1.0) } else { 1.0 };
        let mut loaded = case.model.clone();
        let own = loaded.add_frame_on("payload of a check", frame, Placement::identity());
        loaded.set_payload(own, Inertia { mass: 1.0, ..Inertia::zero() });
        let joints = robot.joints();
        Self {
            loaded,
            limits: robot.torque_limits().iter().map(|limit| share * limit).collect(),
            friction: (joints.iter())
                .map(|joint| [joint.friction.coulomb_nm.get(), joint.friction.viscous_nms_per_rad.get()])
                .collect(),
            by_robot: robot.file.interface.gravity_compensated_by == GravityCompensation::Robot,
        }
    }

    /// Least payload (kg) and multiple of the target forces along references.
    fn along(&self, case: &PreflightCase<'_>, instants: &[Instant]) -> [Least; 2] {
        let mut data = case.data.clone();
        let mut with_load = Data::new(&self.loaded);
        let [mut payload, mut forces] = [Least::NONE; 2];
        for (before, after) in pairs(instants) {
            let step_s = after.time_s - before.time_s;
            let ddq: Vec<f64> = before.dq.iter().zip(&after.dq).map(|(a, b)| (b - a) / step_s).collect();
            for (model, data) in [(case.model, &mut data), (&self.loaded, &mut with_load)] {
                kinematics(model, data, &before.q, &before.dq);
                rnea(model, data, &ddq);
            }
            let pressing = pressing_torques(case, before.task_set, &data);
            for joint in 0..case.model.n() {
                let more = with_load.torque[joint] - data.torque[joint];
                let gravity = if self.by_robot { before.gravity[joint] } else { 0.0 };
                let [coulomb, viscous] = self.friction[joint];
                let dq = before.dq[joint];
                let friction = if dq.abs() > 1e-6 { coulomb * dq.signum() + viscous * dq } else { 0.0 };
                let taken = data.torque[joint] - gravity + friction;
                payload.add(joint, taken, self.limits[joint], more);
                if let Some(pressing) = &pressing {
                    forces.add(joint, taken, self.limits[joint], pressing[joint]);
                }
            }
        }
        [payload, forces]
    }
}

/// Joint torques that exert the target forces of the tasks of a set (n; Nm, N); `None` without any.
fn pressing_torques(case: &PreflightCase<'_>, task_set: usize, data: &Data) -> Option<Vec<f64>> {
    let mut torques: Option<Vec<f64>> = None;
    for motion in &case.task_sets[task_set].motions {
        let target = motion.parameters.target_force();
        // The forces of two hands on each other are not those of one on the environment.
        let ControlledFrame::Frame(frame) = motion.controlled else { continue };
        if target == Vector6::zeros() {
            continue;
        }
        let axes = motion.axes(case.model, data);
        let mut jacobian = Matrix6xX::zeros(case.model.n());
        frame_jacobian(case.model, data, frame, &mut jacobian);
        let [force, moment] = [0, 3].map(|row| axes * target.fixed_rows::<3>(row));
        let torques = torques.get_or_insert_with(|| vec![0.0; case.model.n()]);
        for (torque, column) in torques.iter_mut().zip(jacobian.column_iter()) {
            // The target is the force on the robot: the joints bear the opposite one.
            *torque -= column.fixed_rows::<3>(0).dot(&force) + column.fixed_rows::<3>(3).dot(&moment);
        }
    }
    torques
}
