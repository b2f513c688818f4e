//! The task's references, and joints that follow them without error, limits or forces.
//!
//! The references are those of the controller itself, events included. The joints follow by damped least squares:
//!
//! ```text
//! q̇ = J⁺ (ẋ_d + 20 (x_d − x)) + (I − J⁺ J) q̇_0        J⁺ = Jᵀ (J Jᵀ + μ² I)⁻¹
//! ```
//!
//! with the axes in motion of all tasks in J, and what the task of all joints asks for in q̇_0.

use super::motion::Motion;
use super::{Case, input};
use nalgebra::{DMatrix, DVector, Matrix3, Quaternion, UnitQuaternion, Vector3};
use opspace_backend::{Observable, Row, Signal};
use opspace_control::ik::{ERROR_GAIN_PER_S, POSTURE_GAIN_PER_S};
use opspace_control::{Controller, Measurement, Targets, TaskParameters, orientation};
use opspace_model::{Motion as Velocity, Placement, update};
use std::collections::BTreeMap;

/// Longest step, s: errors are worked off with a time constant of 0.05 s.
const LONGEST_STEP_S: f64 = 0.01;

/// In how many steps a run is followed, where that makes them no longer.
const STEPS: f64 = 2000.0;

/// How many steps are followed: ten minutes of the longest, so that a run of days is not waited for.
const MOST_STEPS: usize = 60_000;

/// How many instants are kept.
const KEPT: usize = 4000;

/// μ² against the trace of J Jᵀ.
const DAMPING: f64 = 1e-6;

/// How far the joints may move in a step, rad or m: more is what becomes of a goal out of reach.
const LARGEST_STEP: f64 = 0.2;

/// A run, followed.
pub(crate) struct Followed {
    /// In the order of time; none where the task can't be followed.
    pub instants: Vec<Instant>,
    /// Whether the last of them is the run's last.
    pub to_the_end: bool,
}

/// What an instant of a run asks for.
pub(crate) struct Instant {
    pub time_s: f64,
    /// Which is in force.
    pub stack: usize,
    /// Of the joints, rad or m (n).
    pub q: Vec<f64>,
    /// What of the joints' velocity the references ask for, rad/s or m/s (n).
    pub dq: Vec<f64>,
    /// Nm or N (n).
    pub gravity: Vec<f64>,
    /// One for each of the stack's motions.
    pub targets: Vec<Target>,
    /// Of the joint-tracking tasks, by name.
    pub joints: BTreeMap<String, JointTarget>,
}

/// Where a frame should be.
pub(crate) struct Target {
    pub placement: Placement,
    /// In the coordinates of what the task leads.
    pub velocity: Velocity,
    /// By how much it is missed, m with rotations scaled to it.
    pub missed: f64,
}

/// Where joints should be.
pub(crate) struct JointTarget {
    /// rad or m (n).
    pub position: Vec<f64>,
    /// rad/s or m/s (n).
    pub velocity: Vec<f64>,
}

impl Followed {
    pub(crate) fn new(case: &Case<'_>) -> Self {
        let duration_s = case.experiment.duration_s();
        let period_s = case.experiment.profile().1.period_s();
        let step_s = (duration_s / STEPS).min(LONGEST_STEP_S).max(period_s);
        let all = (duration_s / step_s).round() as usize;
        let steps = all.min(MOST_STEPS);
        let every = steps.div_ceil(KEPT).max(1);
        let (mut instants, mut followed) = (Vec::new(), 0);
        if let Some(mut follower) = Follower::new(case, step_s) {
            for step in 0..=steps {
                let Some(instant) = follower.step(step as f64 * step_s) else { break };
                followed = step;
                if step % every == 0 || step == steps {
                    instants.push(instant);
                }
            }
        }
        Self { instants, to_the_end: followed == all }
    }
}

struct Follower<'a> {
    case: &'a Case<'a>,
    controller: opspace_control::OperationalSpaceController,
    signals: Vec<Signal>,
    row: Vec<f64>,
    measurement: Measurement,
    data: opspace_model::Data,
    step_s: f64,
    torque: Vec<f64>,
    /// Zero (n).
    feedforward_torque: Vec<f64>,
    targets: Targets,
    /// The orientations that were asked for a step before, by task.
    turned: BTreeMap<&'a str, Matrix3<f64>>,
    started: bool,
}

impl<'a> Follower<'a> {
    fn new(case: &'a Case<'a>, step_s: f64) -> Option<Self> {
        let controller = case.experiment.unlimited_controller(step_s)?;
        let signals = controller.signals();
        let n = case.model.n();
        let mut measurement = Measurement::new(n, case.experiment.robot().sensors.len(), false);
        measurement.q.copy_from_slice(&case.start);
        Some(Self {
            case,
            controller,
            row: vec![0.0; signals.iter().map(Signal::len).sum()],
            signals,
            measurement,
            data: case.data.clone(),
            step_s,
            torque: vec![0.0; n],
            feedforward_torque: vec![0.0; n],
            targets: Targets::none(),
            turned: BTreeMap::new(),
            started: false,
        })
    }

    /// What is asked for at that time; the joints then follow.
    fn step(&mut self, time_s: f64) -> Option<Instant> {
        let (case, model) = (self.case, self.case.model);
        self.measurement.time_s = time_s;
        if !update(model, &mut self.data, self.measurement.q.as_slice(), self.measurement.dq.as_slice()) {
            return None;
        }
        let input = input(model, &self.data, &self.measurement, &self.feedforward_torque, &self.targets);
        if !self.started {
            self.controller.start(&input);
            self.started = true;
        }
        self.controller.update(&input, &mut self.torque);
        self.controller.sample(&mut Row::new(&mut self.row));
        // As the controller counts: half a nanosecond early is in time.
        let stack = case.stacks.iter().rposition(|stack| stack.from_s <= time_s + 5e-10).unwrap_or(0);
        let in_force = &case.stacks[stack];

        let mut wanted = Wanted::new(model.n());
        let mut targets = Vec::new();
        for motion in &in_force.motions {
            let mut target = self.target(motion)?;
            let axes = motion.axes(model, &self.data, motion.parameters.motion_axes());
            let rows = motion.rows(model, &self.data, &axes);
            let error = axes.rows_of(&motion.error(model, &self.data, &target.placement));
            target.missed = error.norm();
            let velocity = axes.rows_of(&axes.of_motion(&target.velocity));
            for row in 0..axes.rows() {
                wanted.push(rows.row(row).iter().copied(), velocity[row], error[row]);
            }
            targets.push(target);
        }
        let mut joints = BTreeMap::new();
        for name in in_force.priority {
            self.joint_task(name, &in_force.task[name], &mut wanted, &mut joints);
        }

        let (dq, correction) = wanted.solve();
        let instant = Instant {
            time_s,
            stack,
            q: self.measurement.q.as_slice().to_vec(),
            gravity: self.data.gravity.as_slice().to_vec(),
            targets,
            joints,
            dq: dq.as_slice().to_vec(),
        };
        let step = (dq + correction) * self.step_s;
        let shorter = (LARGEST_STEP / step.norm()).min(1.0);
        self.measurement.q += step * shorter;
        Some(instant)
    }

    /// What a task of joints adds.
    fn joint_task(
        &self,
        name: &str,
        task: &TaskParameters,
        wanted: &mut Wanted,
        joints: &mut BTreeMap<String, JointTarget>,
    ) {
        let (model, q) = (self.case.model, &self.measurement.q);
        match task {
            TaskParameters::JointTracking(tracking) => {
                let (Some(position), Some(velocity)) =
                    (self.signal(name, "reference"), self.signal(name, "reference_velocity"))
                else {
                    return;
                };
                let selected = tracking.joints.iter().flatten();
                for joint in selected.filter_map(|name| model.joint(name).ok()) {
                    let row = (0..model.n()).map(|i| f64::from(u8::from(i == joint)));
                    wanted.push(row, velocity[joint], position[joint] - q[joint]);
                }
                if tracking.joints.is_none() {
                    wanted.rest_velocity.copy_from_slice(velocity);
                    for (i, rest) in wanted.rest_correction.iter_mut().enumerate() {
                        *rest = ERROR_GAIN_PER_S * (position[i] - q[i]);
                    }
                }
                let target = JointTarget { position: position.to_vec(), velocity: velocity.to_vec() };
                joints.insert(name.to_owned(), target);
            }
            TaskParameters::JointPosture(posture) => {
                for (i, rest) in wanted.rest_correction.iter_mut().enumerate() {
                    let named = posture.posture_rad.get(self.case.joint(i)).copied();
                    *rest = POSTURE_GAIN_PER_S * (named.unwrap_or(self.case.start[i]) - q[i]);
                }
            }
            _ => {}
        }
    }

    fn target(&mut self, motion: &Motion<'a>) -> Option<Target> {
        let [position, linear] = ["reference", "reference_velocity"]
            .map(|quantity| self.signal(motion.name, quantity).map(Vector3::from_column_slice));
        let quaternion = self.signal(motion.name, "reference_orientation")?;
        let quaternion = Quaternion::new(quaternion[0], quaternion[1], quaternion[2], quaternion[3]);
        let rotation = *UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix().matrix();
        let before = self.turned.insert(motion.name, rotation).unwrap_or(rotation);
        let angular = orientation::log(&(rotation * before.transpose())) / self.step_s;
        Some(Target {
            placement: Placement { rotation, translation: position? },
            velocity: Velocity { linear: linear?, angular },
            missed: 0.0,
        })
    }

    /// A signal of the controller, if its task is in force.
    fn signal(&self, task: &str, quantity: &str) -> Option<&[f64]> {
        let name = format!("{task}.{quantity}");
        let place = self.signals.iter().position(|signal| signal.name == name)?;
        let begin: usize = self.signals[..place].iter().map(Signal::len).sum();
        let values = &self.row[begin..begin + self.signals[place].len()];
        values.iter().all(|value| value.is_finite()).then_some(values)
    }
}

/// Rows of all tasks, and what the joints do beside them.
struct Wanted {
    rows: Vec<f64>,
    velocity: Vec<f64>,
    error: Vec<f64>,
    rest_velocity: DVector<f64>,
    rest_correction: DVector<f64>,
}

impl Wanted {
    fn new(n: usize) -> Self {
        Self {
            rows: Vec::new(),
            velocity: Vec::new(),
            error: Vec::new(),
            rest_velocity: DVector::zeros(n),
            rest_correction: DVector::zeros(n),
        }
    }

    fn push(&mut self, row: impl Iterator<Item = f64>, velocity: f64, error: f64) {
        self.rows.extend(row);
        self.velocity.push(velocity);
        self.error.push(error);
    }

    /// q̇ that the references ask for, and what works their errors off.
    fn solve(self) -> (DVector<f64>, DVector<f64>) {
        let (m, n) = (self.velocity.len(), self.rest_velocity.len());
        if m == 0 {
            return (self.rest_velocity, self.rest_correction);
        }
        let jacobian = DMatrix::from_row_slice(m, n, &self.rows);
        let mut square = &jacobian * jacobian.transpose();
        let damping = DAMPING * square.trace();
        (0..m).for_each(|i| square[(i, i)] += damping);
        let Some(factor) = square.cholesky() else {
            return (self.rest_velocity, self.rest_correction);
        };
        let follow = |task: DVector<f64>, rest: DVector<f64>| {
            let left = task - &jacobian * &rest;
            rest + jacobian.tr_mul(&factor.solve(&left))
        };
        let errors = DVector::from_vec(self.error) * ERROR_GAIN_PER_S;
        (follow(DVector::from_vec(self.velocity), self.rest_velocity), follow(errors, self.rest_correction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Choice, Experiment, Files};
    use std::path::Path;

    /// Where the joints are, by forward kinematics, against where the reference is: all along a way out and back, which
    /// joints led by velocities alone leave by 1.4 mm.
    #[test]
    fn the_joints_follow_the_reference() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/ur5e-reach.toml");
        let experiment = Experiment::load(Files::Disk, &path, None, Choice::default(), &[]).expect("a task");
        let case = Case::new(&experiment).expect("a start");
        let followed = Followed::new(&case);
        assert!(followed.instants.len() > 1000);
        let farthest = followed.instants.iter().map(|i| i.targets[0].missed).fold(0.0, f64::max);
        assert!(farthest < 3e-4, "{farthest} m");
        let ways = followed.instants.iter().map(|i| (i.q[0] - case.start[0]).abs()).fold(0.0, f64::max);
        assert!(ways > 0.1, "it goes somewhere: {ways} rad");
    }
}
