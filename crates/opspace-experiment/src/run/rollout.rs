//! Kinematic rollout: the references of a task, and joints that follow them without error or forces, with or without
//! position limits.
//!
//! The references are those of the controller, including events. The joints follow by damped least squares:
//!
//! ```text
//! q̇ = J⁺ (ẋ_d + 20 (x_d − x)) + (I − J⁺ J) q̇_0        J⁺ = Jᵀ (J Jᵀ + μ² I)⁻¹
//! ```
//!
//! J contains the rows of all tasks that follow a reference, q̇_0 the velocities of the joint task. With position limits,
//! joints that would leave their range are at rest, the others follow as well as they can, and the rows of each task count
//! ten times as much as those of the next one.

use nalgebra::{DMatrix, DVector, Matrix6xX, Vector6};
use opspace_control::ik::{ERROR_GAIN_PER_S, POSTURE_GAIN_PER_S};
use opspace_control::{
    ControlInput, Controller, Measurement, OperationalSpaceController, PathPlace, Targets, Task, TaskSet,
};
use opspace_model::{Data, Model, update};
use std::collections::BTreeMap;

/// Longest step, s: errors decay with a time constant of 0.05 s.
const LONGEST_STEP_S: f64 = 0.01;

/// Number of steps of a run, unless they would be longer than `LONGEST_STEP_S`.
const STEPS: f64 = 2000.0;

/// Maximum number of steps, which is ten minutes at `LONGEST_STEP_S`: it limits the computing time of long runs.
const MAX_STEPS: usize = 60_000;

/// Maximum number of instants that are stored.
const KEPT: usize = 4000;

/// μ² relative to the trace of J Jᵀ.
const DAMPING: f64 = 1e-6;

/// Weight of the rows of a task relative to those of the task above, at position limits.
const LOWER_PRIORITY: f64 = 0.1;

/// Largest motion of a joint in a step, rad or m: a goal out of reach would require more.
const LARGEST_STEP: f64 = 0.2;

/// Run whose references are rolled out.
pub struct RolloutCase<'a> {
    /// Rigid bodies of the robot.
    pub model: &'a Model,
    /// Joint positions at the start, rad or m (n).
    pub start: &'a [f64],
    /// Number of force sensors.
    pub sensors: usize,
    /// Duration of control, s.
    pub duration_s: f64,
    /// Control period, s.
    pub period_s: f64,
    /// Times from which the task sets are active, s.
    pub from_s: Vec<f64>,
    /// Ranges in which the joints are kept, rad or m (n); `None` if they move without position limits.
    pub ranges: Option<Vec<(f64, f64)>>,
    /// Creates the controller without limits for an update period, s.
    pub controller: Box<dyn Fn(f64) -> Option<OperationalSpaceController> + 'a>,
}

/// Rollout of a run.
pub struct Rollout {
    /// Instants in order of time; empty if the references cannot be followed.
    pub instants: Vec<Instant>,
    /// True if the last instant is the end of the run.
    pub to_the_end: bool,
}

/// Demands of the references at an instant of a run.
pub struct Instant {
    /// Time after the start of control, s.
    pub time_s: f64,
    /// Number of the step, from 0.
    pub step: usize,
    /// Index of the active task set.
    pub task_set: usize,
    /// Joint positions, rad or m (n).
    pub q: Vec<f64>,
    /// Joint velocities demanded by the references, rad/s or m/s (n).
    pub dq: Vec<f64>,
    /// Torques of gravity, Nm or N (n).
    pub gravity: Vec<f64>,
    /// Demands of the tasks with at most six rows, in order of priority.
    pub tasks: Vec<TaskInstant>,
    /// Targets of joints, by the name of the task that sets them.
    pub joints: BTreeMap<String, Vec<JointTarget>>,
    /// Places on paths, by the name of the task that follows the path.
    pub paths: BTreeMap<String, PathInstant>,
}

/// A task at an instant on its path.
pub struct PathInstant {
    /// Place on the path, with its derivatives.
    pub place: PathPlace,
    /// Largest ratio of a speed of the reference to the limit of the task; 0 without limits.
    pub speed_ratio: f64,
}

/// Demand of a task at an instant.
pub struct TaskInstant {
    /// Norm of the velocity that it demands, over its rows.
    pub velocity: f64,
    /// Linear (m/s) and angular (rad/s) speed of its reference; `None` without a reference.
    pub speeds: [Option<f64>; 2],
    /// Limits of these speeds (m/s, rad/s); `None` without a limit.
    pub speed_limits: [Option<f64>; 2],
    /// Error of its rows; zero for rows without a reference.
    pub error: Vector6<f64>,
}

/// Reference of a joint.
#[derive(Clone, Copy)]
pub struct JointTarget {
    /// Index of the joint.
    pub joint: usize,
    /// Position, rad or m.
    pub position: f64,
    /// Velocity, rad/s or m/s.
    pub velocity: f64,
}

/// Error of a task's rows at the state of `data`; zero for rows without a reference.
#[must_use]
pub fn error(task: &dyn Task, model: &Model, data: &Data) -> Vector6<f64> {
    let [velocity, with_error] = [0.0, 1.0].map(|gain| task.kinematic_target(model, data, gain));
    let error = with_error - velocity;
    Vector6::from_fn(|row, _| if row < task.rows() && task.follows_reference(row) { error[row] } else { 0.0 })
}

/// Steps of a run.
struct Steps {
    length_s: f64,
    /// Number of steps of the whole run, and number of steps that are computed.
    all: usize,
    count: usize,
}

impl Steps {
    fn new(case: &RolloutCase<'_>) -> Self {
        let length_s = (case.duration_s / STEPS).min(LONGEST_STEP_S).max(case.period_s);
        let all = (case.duration_s / length_s).round() as usize;
        Self { length_s, all, count: all.min(MAX_STEPS) }
    }
}

impl Rollout {
    /// Follows the references of a run without error, as far as this is possible.
    #[must_use]
    pub fn new(case: &RolloutCase<'_>) -> Self {
        let steps = Steps::new(case);
        let every = steps.count.div_ceil(KEPT).max(1);
        let (mut instants, mut followed) = (Vec::new(), 0);
        if let Some(mut follower) = RolloutState::new(case, steps.length_s) {
            for step in 0..=steps.count {
                let Some(instant) = follower.step(step) else { break };
                followed = step;
                if step % every == 0 || step == steps.count {
                    instants.push(instant);
                }
            }
        }
        Self { instants, to_the_end: followed == steps.all }
    }

    /// Repeats the rollout and passes the tasks at the given steps to `visit`, in order of time.
    pub fn revisit(case: &RolloutCase<'_>, steps: &[usize], mut visit: impl FnMut(usize, &TaskSet)) {
        let Some(&last) = steps.iter().max() else { return };
        let Some(mut follower) = RolloutState::new(case, Steps::new(case).length_s) else { return };
        for step in 0..=last {
            if follower.step(step).is_none() {
                return;
            }
            if steps.contains(&step) {
                visit(step, follower.controller.tasks());
            }
        }
    }
}

struct RolloutState<'a> {
    case: &'a RolloutCase<'a>,
    controller: OperationalSpaceController,
    measurement: Measurement,
    data: Data,
    step_s: f64,
    torque: Vec<f64>,
    /// Zeros (n).
    feedforward_torque: Vec<f64>,
    targets: Targets,
    rows: Matrix6xX<f64>,
    started: bool,
}

impl<'a> RolloutState<'a> {
    fn new(case: &'a RolloutCase<'a>, step_s: f64) -> Option<Self> {
        let controller = (case.controller)(step_s)?;
        let n = case.model.n();
        let mut measurement = Measurement::new(n, case.sensors, false);
        measurement.q.copy_from_slice(case.start);
        Some(Self {
            case,
            controller,
            measurement,
            data: Data::new(case.model),
            step_s,
            torque: vec![0.0; n],
            feedforward_torque: vec![0.0; n],
            targets: Targets::none(),
            rows: Matrix6xX::zeros(n),
            started: false,
        })
    }

    /// Computes the demands at a step, then moves the joints; `None` if the demands cannot be computed.
    fn step(&mut self, step: usize) -> Option<Instant> {
        let (case, model) = (self.case, self.case.model);
        let time_s = step as f64 * self.step_s;
        self.measurement.time_s = time_s;
        if !update(model, &mut self.data, self.measurement.q.as_slice(), self.measurement.dq.as_slice()) {
            return None;
        }
        let input =
            ControlInput::new(model, &self.data, &self.measurement, &self.feedforward_torque, &self.targets);
        if !self.started {
            self.controller.start(&input);
            self.started = true;
        }
        self.controller.update(&input, &mut self.torque);
        // Same rule as in the controller: an event takes effect up to half a nanosecond early.
        let stack = case.from_s.iter().rposition(|from_s| *from_s <= time_s + 5e-10).unwrap_or(0);

        let mut wanted = DemandedMotion::new(model.n());
        let (mut joints, mut paths) = (BTreeMap::new(), BTreeMap::new());
        let tasks = self.controller.tasks();
        let mut instants = Vec::new();
        for (place, task) in tasks.tasks().enumerate() {
            let weight = if case.ranges.is_some() { LOWER_PRIORITY.powi(place as i32) } else { 1.0 };
            let (velocity, error) =
                (task.kinematic_target(model, &self.data, 0.0), error(task, model, &self.data));
            if !(velocity.iter().chain(&error).all(|x| x.is_finite())) {
                return None;
            }
            task.jacobian(model, &self.data, &mut self.rows);
            let mut own = Vec::new();
            for row in (0..task.rows()).filter(|&row| task.follows_reference(row)) {
                let entries = self.rows.row(row);
                let entries = entries.iter().map(|entry| weight * entry);
                wanted.push(entries, weight * velocity[row], weight * error[row]);
                if let Some(joint) = single_joint(self.rows.row(row).iter().copied()) {
                    let position = self.measurement.q[joint] + error[row];
                    own.push(JointTarget { joint, position, velocity: velocity[row] });
                }
            }
            if !own.is_empty() {
                joints.insert(task.name().to_owned(), own);
            }
            let speed_limits = task.speed_limits().map(|limit| limit.map(|limit| limit.limit));
            let (velocity, speeds) = (velocity.norm(), task.reference_speeds());
            if let Some(place) = task.path_place(time_s) {
                let ratios =
                    speeds.iter().zip(&speed_limits).filter_map(|(speed, limit)| Some((*speed)? / (*limit)?));
                let speed_ratio = ratios.fold(0.0, f64::max);
                paths.insert(task.name().to_owned(), PathInstant { place, speed_ratio });
            }
            instants.push(TaskInstant { velocity, speeds, speed_limits, error });
        }
        if let Some(task) = tasks.joint_task() {
            let q = self.measurement.q.as_slice();
            let correction = wanted.rest_correction.as_mut_slice();
            if task.kinematic_target(q, ERROR_GAIN_PER_S, POSTURE_GAIN_PER_S, correction)
                && let Some((position, velocity)) = task.reference()
            {
                wanted.rest_velocity.copy_from_slice(velocity);
                wanted.rest_correction -= &wanted.rest_velocity;
                let own = position.iter().zip(velocity).enumerate();
                let own =
                    own.map(|(joint, (&position, &velocity))| JointTarget { joint, position, velocity });
                joints.insert(task.name().to_owned(), own.collect());
            }
        }

        let (dq, correction) = self.within_ranges(&wanted);
        let instant = Instant {
            time_s,
            step,
            task_set: stack,
            q: self.measurement.q.as_slice().to_vec(),
            gravity: self.data.gravity.as_slice().to_vec(),
            tasks: instants,
            joints,
            paths,
            dq: dq.as_slice().to_vec(),
        };
        let step = (dq + correction) * self.step_s;
        let shorter = (LARGEST_STEP / step.norm()).min(1.0);
        self.measurement.q += step * shorter;
        for (q, (lower, upper)) in self.measurement.q.iter_mut().zip(case.ranges.iter().flatten()) {
            *q = q.max(*lower).min(*upper);
        }
        Some(instant)
    }

    /// Joint velocities that follow the references, and those that correct the errors, with the joints at rest that would
    /// leave their ranges.
    fn within_ranges(&self, wanted: &DemandedMotion) -> (DVector<f64>, DVector<f64>) {
        let mut at_rest = vec![false; self.measurement.q.len()];
        loop {
            let (dq, correction) = wanted.solve(&at_rest);
            let mut is_within = true;
            for (joint, (lower, upper)) in self.case.ranges.iter().flatten().enumerate() {
                let next = self.measurement.q[joint] + (dq[joint] + correction[joint]) * self.step_s;
                if !at_rest[joint] && (next < *lower || next > *upper) {
                    at_rest[joint] = true;
                    is_within = false;
                }
            }
            if is_within {
                return (dq, correction);
            }
        }
    }
}

/// Joint to which a row of a Jacobian belongs, if the row selects a single joint; `None` for other rows.
fn single_joint(row: impl Iterator<Item = f64>) -> Option<usize> {
    let mut used = row.enumerate().filter(|(_, x)| *x != 0.0);
    let (joint, x) = used.next()?;
    (x == 1.0 && used.next().is_none()).then_some(joint)
}

/// Rows of all tasks, and the joint motion in their null space.
struct DemandedMotion {
    rows: Vec<f64>,
    velocity: Vec<f64>,
    error: Vec<f64>,
    rest_velocity: DVector<f64>,
    rest_correction: DVector<f64>,
}

impl DemandedMotion {
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

    /// Joint velocities demanded by the references, and those that correct the errors; zero for joints `at_rest` (n).
    fn solve(&self, at_rest: &[bool]) -> (DVector<f64>, DVector<f64>) {
        let (m, n) = (self.velocity.len(), self.rest_velocity.len());
        let moving = |velocity: &DVector<f64>| {
            DVector::from_fn(n, |joint, _| if at_rest[joint] { 0.0 } else { velocity[joint] })
        };
        let (rest_velocity, rest_correction) = (moving(&self.rest_velocity), moving(&self.rest_correction));
        if m == 0 {
            return (rest_velocity, rest_correction);
        }
        let mut jacobian = DMatrix::from_row_slice(m, n, &self.rows);
        (0..n).filter(|&joint| at_rest[joint]).for_each(|joint| jacobian.column_mut(joint).fill(0.0));
        let mut square = &jacobian * jacobian.transpose();
        let damping = DAMPING * square.trace();
        (0..m).for_each(|i| square[(i, i)] += damping);
        let Some(factor) = square.cholesky() else {
            return (rest_velocity, rest_correction);
        };
        let follow = |task: DVector<f64>, rest: DVector<f64>| {
            let left = task - &jacobian * &rest;
            rest + jacobian.tr_mul(&factor.solve(&left))
        };
        let errors = DVector::from_column_slice(&self.error) * ERROR_GAIN_PER_S;
        let velocity = DVector::from_column_slice(&self.velocity);
        (follow(velocity, rest_velocity), follow(errors, rest_correction))
    }
}
