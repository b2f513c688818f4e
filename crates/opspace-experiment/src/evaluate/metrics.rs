//! Metrics of a run, computed only from its log.
//!
//! Statistics cover the time from `settle_s` after the first control cycle to the last control cycle; the start of
//! the robot's clock does not matter. Positions are the true ones if the log contains them (simulation), otherwise
//! the measured ones.

mod chatter;
mod joints;
mod ripple;
mod tasks;

pub use joints::JointMetrics;
pub use tasks::{ElementError, TaskMetrics};

use crate::run::experiment::{ControllerKind, Experiment};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use opspace_backend::quantity::Positive;
use opspace_backend::signal_names::{
    self, COMMAND, DQ, FORCE, LIMITS_SOLVER, MIN_SINGULAR_GAIN, MISSED_CYCLES, MOTOR_TORQUE, PHASE, Q,
    REFERENCE, REFERENCE_ORIENTATION, SERVO_CHANNEL, SETPOINT_ACCELERATION, SETPOINT_SPEED, TICK_CHANNEL,
    TICK_TIME, TORQUE_DESIRED, TORQUE_SATURATED, TRUTH_CHANNEL,
};
use opspace_backend::{CommandKind, Setpoints};
use opspace_control::orientation::log;
use opspace_control::{AxesFrame, CartesianParameters, ControlledFrame};
use opspace_log::{ChannelData, Column, Recording};
use opspace_loop::Phase;
use opspace_model::{Data, FrameId, Placement, frame_placement, kinematics};
use opspace_sim::{EnvironmentObjectParameters, WorldAxis};
use serde::Serialize;
use std::collections::BTreeMap;

/// Metrics of a run; a metric that does not apply to the run is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Metrics {
    /// Distance from the reference over the motion axes, rms, m.
    pub position_rms_m: Option<f64>,
    /// Largest distance from the reference over the motion axes, m.
    pub position_max_m: Option<f64>,
    /// Angle from the reference over the motion axes, rms, rad.
    pub orientation_rms_rad: Option<f64>,
    /// Largest angle from the reference over the motion axes, rad.
    pub orientation_max_rad: Option<f64>,
    /// Joint error of a joint task, rms over time and joints, rad.
    pub joint_rms_rad: Option<f64>,
    /// Error of the true contact force over the force axes of the first task that has some, rms, N.
    pub force_rms_n: Option<f64>,
    /// Fraction of the time after settling in which this task has contact.
    pub in_contact_fraction: Option<f64>,
    /// Time from the start of control to the first contact of this task, s.
    pub contact_begin_s: Option<f64>,
    /// Largest true contact force of this task in the first second of contact, N.
    pub contact_peak_n: Option<f64>,
    /// Number of times that this task lost contact.
    pub contact_losses: Option<u64>,
    /// Displacement from the start over the compliant axes of the first task that has some, rms, m.
    pub compliant_motion_rms_m: Option<f64>,
    /// Work of the environment over these axes, J.
    pub compliant_work_j: Option<f64>,
    /// True force of the simulated hand over the axes that it reports, rms, N.
    pub hand_force_rms_n: Option<f64>,
    /// Displacement of the simulated hand's frame from the start over the axes that the hand reports, rms, m.
    pub hand_motion_rms_m: Option<f64>,
    /// Error of the motor torque at servo rate, relative to the desired torque.
    pub torque_error_servo: Option<f64>,
    /// Error of the mean motor torque over each interface interval, relative to the desired torque.
    pub torque_error_interval: Option<f64>,
    /// Error of the motor torque in the first servo period of each interface cycle, relative to the desired torque.
    pub torque_error_tick: Option<f64>,
    /// Torque error within the interface intervals, √(e_servo² − e_interval²) in Nm, relative to the ripple that a
    /// held setpoint inevitably causes there at the speeds of the run; `None` if no setpoint is held.
    pub hold_ripple: Option<f64>,
    /// Highest speed of a position setpoint, rad/s.
    pub setpoint_speed_max_rad_per_s: Option<f64>,
    /// Highest acceleration of a velocity setpoint, rad/s².
    pub setpoint_acceleration_max_rad_per_s2: Option<f64>,
    /// Fraction of interface cycles in which a desired torque was saturated.
    pub torque_saturated_share: Option<f64>,
    /// Largest torque that the controller commanded to a joint, before saturation, Nm.
    pub torque_commanded_max_nm: Option<f64>,
    /// Largest change of a commanded torque from one interface cycle to the next, Nm.
    pub torque_step_max_nm: Option<f64>,
    /// Highest speed of a joint, rad/s.
    pub speed_max_rad_per_s: Option<f64>,
    /// Fraction of interface cycles in which a limit changed the command.
    pub limited_share: Option<f64>,
    /// Fraction of control cycles in which a task was damped near a singular pose.
    pub damped_fraction: Option<f64>,
    /// Fraction of interface cycles that were missed during control.
    pub missed_fraction: Option<f64>,
    /// Desired torque above 8 Hz of the joint with the most, rms, Nm.
    pub torque_chatter_rms_nm: Option<f64>,
    /// Frequency of the largest line of that torque above 8 Hz, Hz.
    pub torque_chatter_hz: Option<f64>,
    /// Largest `torque_error_of_limit` of a joint: the rms error of the mean motor torque relative to the torque limit.
    pub torque_error_of_limit_max: Option<f64>,
}

/// Computing times of a run; they are not reproducible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Timing {
    /// Median duration of a control cycle with estimator, model, control and transformer, ns.
    pub tick_ns_median: f64,
    /// Duration of a control cycle with estimator, model, control and transformer, 99th percentile, ns.
    pub tick_ns_p99: f64,
    /// Largest duration of a control cycle with estimator, model, control and transformer, ns.
    pub tick_ns_max: f64,
    /// Ratio of robot time to wall-clock time.
    pub realtime_factor: Option<f64>,
}

/// Metrics of a run as a whole, of each of its tasks, and of each joint of the robot.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Evaluation {
    /// Metrics of the run.
    pub metrics: Metrics,
    /// Metrics of the tasks that have a priority at the start, by name.
    pub tasks: BTreeMap<String, TaskMetrics>,
    /// Metrics of the joints, by name.
    pub joints: BTreeMap<String, JointMetrics>,
}

/// Computes all metrics of a run from its log.
#[must_use]
pub fn evaluate(experiment: &Experiment, recording: &Recording) -> Evaluation {
    let Some(run) = Run::new(experiment, recording) else { return Evaluation::default() };
    let (mut metrics, intervals) = run.torque_errors();
    let (tasks, joints) = (run.tasks(), run.joints(&intervals));
    for name in &experiment.task().file.priority {
        if let Some(task) = tasks.get(name) {
            metrics.add_task(task);
        }
    }
    for joint in joints.values() {
        metrics.add_joint(joint);
    }
    run.cycles(&mut metrics);
    run.hand(&mut metrics);
    metrics.setpoint_speed_max_rad_per_s = run.largest(SETPOINT_SPEED);
    metrics.setpoint_acceleration_max_rad_per_s2 = run.largest(SETPOINT_ACCELERATION);
    metrics.torque_saturated_share = run.tick.signal(TORQUE_SATURATED).and_then(|saturated| {
        mean(run.settled(&run.tick.time_s).map(|k| saturated.row(k).iter().copied().fold(0.0, f64::max)))
    });
    run.peaks(&mut metrics);
    Evaluation { metrics, tasks, joints }
}

/// Computes the metrics of a run as a whole from its log.
#[must_use]
pub fn metrics(experiment: &Experiment, recording: &Recording) -> Metrics {
    evaluate(experiment, recording).metrics
}

impl Metrics {
    /// Takes the errors of a task where no task of higher priority has any.
    fn add_task(&mut self, task: &TaskMetrics) {
        if self.position_rms_m.is_none() && self.orientation_rms_rad.is_none() {
            (self.position_rms_m, self.position_max_m) = (task.position_rms_m, task.position_max_m);
            (self.orientation_rms_rad, self.orientation_max_rad) =
                (task.orientation_rms_rad, task.orientation_max_rad);
        }
        if self.joint_rms_rad.is_none() && task.kind == "joint-tracking" {
            let angles = task.elements.iter().filter(|element| element.unit == "rad");
            self.joint_rms_rad = mean(angles.map(|element| element.rms.powi(2))).map(f64::sqrt);
        }
        if self.in_contact_fraction.is_none() {
            self.force_rms_n = task.force_rms_n;
            self.in_contact_fraction = task.in_contact_fraction;
            (self.contact_begin_s, self.contact_peak_n) = (task.contact_begin_s, task.contact_peak_n);
            self.contact_losses = task.contact_losses;
        }
        if self.compliant_motion_rms_m.is_none() {
            self.compliant_motion_rms_m = task.compliant_motion_rms_m;
            self.compliant_work_j = task.compliant_work_j;
        }
    }

    /// Takes the numbers of a joint where they exceed those of all joints before it.
    fn add_joint(&mut self, joint: &JointMetrics) {
        if joint.torque_chatter_rms_nm > self.torque_chatter_rms_nm {
            self.torque_chatter_rms_nm = joint.torque_chatter_rms_nm;
            self.torque_chatter_hz = joint.torque_chatter_hz;
        }
        if joint.torque_error_of_limit > self.torque_error_of_limit_max {
            self.torque_error_of_limit_max = joint.torque_error_of_limit;
        }
    }
}

/// Computes the statistics of the control cycles' durations from a log.
#[must_use]
pub fn timing(recording: &Recording, realtime_factor: Option<f64>) -> Timing {
    let mut ticks: Vec<f64> = Vec::new();
    if let Some(tick) = recording.channel(TICK_CHANNEL)
        && let (Some(phase), Some(time)) = (tick.signal(PHASE), tick.signal(TICK_TIME))
    {
        let controlled = phase.rows().zip(time.rows()).filter(|(p, t)| p[0] == 1.0 && t[0].is_finite());
        ticks.extend(controlled.map(|(_, t)| t[0]));
    }
    ticks.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let index = (share * ticks.len().saturating_sub(1) as f64).round() as usize;
        ticks.get(index).copied().unwrap_or(f64::NAN)
    };
    Timing {
        tick_ns_median: quantile(0.5),
        tick_ns_p99: quantile(0.99),
        tick_ns_max: quantile(1.0),
        realtime_factor,
    }
}

/// Largest gain of a damped inverse that counts as damped: 1 is undamped, except for rounding.
const UNDAMPED: f64 = 1.0 - 1e-9;

/// Log that is evaluated, with its experiment.
struct Run<'a> {
    experiment: &'a Experiment,
    recording: &'a Recording,
    tick: &'a ChannelData,
    /// Times (s) and positions (n; rad or m) of the joints: true ones if the log contains them, otherwise measured
    /// ones.
    joints: (&'a [f64], Column<'a>),
    /// Time of the first cycle of control on the robot's clock, s.
    start_s: f64,
    from_s: f64,
    to_s: f64,
    /// Tolerance within which two times are equal, s: times are rounded multiples of a servo period.
    same_s: f64,
}

impl<'a> Run<'a> {
    fn new(experiment: &'a Experiment, recording: &'a Recording) -> Option<Self> {
        let tick = recording.channel(TICK_CHANNEL)?;
        let phase = tick.signal(PHASE)?;
        let idle = [Phase::Rest, Phase::Stopped].map(Phase::code);
        let mut controlled = (0..tick.len()).filter(|&k| !idle.contains(&phase.row(k)[0]));
        let first = controlled.next()?;
        let last = controlled.next_back().unwrap_or(first);
        let positions = recording.channel(TRUTH_CHANNEL).unwrap_or(tick);
        Some(Self {
            experiment,
            recording,
            tick,
            joints: (&positions.time_s, positions.signal(Q)?),
            start_s: tick.time_s[first],
            from_s: tick.time_s[first] + experiment.task().file.settle_s.get(),
            to_s: tick.time_s[last],
            same_s: 0.25 * experiment.profile().1.servo_period_s(),
        })
    }

    /// Indices of the times in the evaluated interval: after settling, up to the last control cycle.
    fn settled(&self, times: &'a [f64]) -> std::ops::Range<usize> {
        let begin = times.partition_point(|&t| t < self.from_s - self.same_s);
        let end = times.partition_point(|&t| t <= self.to_s + self.same_s);
        begin..end.max(begin)
    }

    /// Index of the interface cycle at row `k` of the joints; `None` if the cycle was missed.
    fn tick_of(&self, k: usize) -> Option<usize> {
        let (times, _) = self.joints;
        let ticks = &self.tick.time_s;
        let tick = ticks.partition_point(|&t| t < times[k] - self.same_s);
        ticks.get(tick).is_some_and(|&t| t <= times[k] + self.same_s).then_some(tick)
    }

    /// Indices of the rows of the joints from the first control cycle to the last.
    fn controlled(&self) -> std::ops::Range<usize> {
        let times = self.joints.0;
        let begin = times.partition_point(|&t| t < self.start_s - self.same_s);
        begin..self.settled(times).end.max(begin)
    }

    /// Pose of a task's controlled frame and the task's axes at each evaluated row of the joints, with the row index.
    fn poses(
        &self,
        subject: ControlledFrame,
        directions: AxesFrame,
    ) -> impl Iterator<Item = (usize, Placement, Matrix3<f64>)> {
        self.poses_of(self.settled(self.joints.0), subject, directions)
    }

    /// Pose of a task's controlled frame and the task's axes at some rows of the joints, with the row index.
    fn poses_of(
        &self,
        rows: std::ops::Range<usize>,
        subject: ControlledFrame,
        directions: AxesFrame,
    ) -> impl Iterator<Item = (usize, Placement, Matrix3<f64>)> {
        let model = &self.experiment.robot().model;
        let mut data = Data::new(model);
        let rest = vec![0.0; model.n()];
        let (_, q) = self.joints;
        rows.map(move |k| {
            kinematics(model, &mut data, q.row(k), &rest);
            let axes = directions.rotation(model, &data, subject);
            (k, subject.placement(model, &data), axes)
        })
    }

    /// Computes the distance and the angle of a task's controlled frame from its reference, along the motion axes.
    fn pose_errors(
        &self,
        name: &str,
        task: &CartesianParameters,
        subject: ControlledFrame,
        metrics: &mut TaskMetrics,
    ) {
        let Ok(directions) = task.axes_frame.resolve(&self.experiment.robot().model, subject) else { return };
        let motion = task.motion_axes();
        if let Some(reference) = self.tick.signal(&signal_names::of(name, REFERENCE))
            && motion[..3].contains(&true)
        {
            let errors = self.poses(subject, directions).filter_map(|(k, pose, axes)| {
                let error = pose.translation - Vector3::from_column_slice(reference.row(self.tick_of(k)?));
                Some(masked_norm(&axes.tr_mul(&error), &motion[..3]))
            });
            (metrics.position_rms_m, metrics.position_max_m) = rms_and_max(errors);
        }
        if let Some(reference) = self.tick.signal(&signal_names::of(name, REFERENCE_ORIENTATION))
            && motion[3..].contains(&true)
        {
            let errors = self.poses(subject, directions).filter_map(|(k, pose, axes)| {
                let reference = orientation(reference.row(self.tick_of(k)?));
                let error = log(&(pose.rotation * reference.transpose()));
                Some(masked_norm(&axes.tr_mul(&error), &motion[3..]))
            });
            (metrics.orientation_rms_rad, metrics.orientation_max_rad) = rms_and_max(errors);
        }
    }

    /// Largest magnitude among the elements of a tick signal; `None` if the signal is missing.
    fn largest(&self, signal: &str) -> Option<f64> {
        let values = self.tick.signal(signal)?;
        let settled = self.settled(&self.tick.time_s);
        Some(settled.flat_map(|k| values.row(k)).fold(0.0, |max: f64, v| max.max(v.abs())))
    }

    /// Computes the largest torques and speeds, and the fraction of limited cycles.
    fn peaks(&self, metrics: &mut Metrics) {
        let largest = |values: &mut dyn Iterator<Item = f64>| {
            values.filter(|v| v.is_finite()).map(f64::abs).reduce(f64::max)
        };
        let ticks = self.settled(&self.tick.time_s);
        let torques = self.experiment.options().controller == ControllerKind::Osc;
        if let Some(command) = self.tick.signal(COMMAND).filter(|_| torques) {
            metrics.torque_commanded_max_nm =
                largest(&mut ticks.clone().flat_map(|k| command.row(k).iter().copied()));
            let steps = ticks.clone().skip(1).flat_map(|k| {
                command.row(k).iter().zip(command.row(k - 1)).map(|(now, before)| now - before)
            });
            metrics.torque_step_max_nm = largest(&mut { steps });
        }
        let positions = self.recording.channel(TRUTH_CHANNEL).unwrap_or(self.tick);
        if let Some(dq) = positions.signal(DQ) {
            let settled = self.settled(&positions.time_s);
            metrics.speed_max_rad_per_s = largest(&mut settled.flat_map(|k| dq.row(k).iter().copied()));
        }
        if let Some(solver) = self.tick.signal(LIMITS_SOLVER) {
            metrics.limited_share = mean(ticks.map(|k| f64::from(u8::from(solver.row(k)[0] != 0.0))));
        }
    }

    /// Computes the fractions of cycles that were missed, and in which a task was damped.
    fn cycles(&self, metrics: &mut Metrics) {
        let ticks = self.settled(&self.tick.time_s);
        if let Some(missed) = self.tick.signal(MISSED_CYCLES) {
            let missed: f64 = ticks.clone().map(|k| missed.row(k)[0]).filter(|count| count.is_finite()).sum();
            metrics.missed_fraction = finite(missed / (missed + ticks.len() as f64));
        }
        let suffix = signal_names::of("", MIN_SINGULAR_GAIN);
        let names = self.tick.layout.signals.iter().map(|signal| signal.name.as_str());
        let gains: Vec<_> =
            names.filter(|name| name.ends_with(&suffix)).filter_map(|name| self.tick.signal(name)).collect();
        if !gains.is_empty() {
            let damped = |k: usize| gains.iter().any(|gain| gain.row(k)[0] < UNDAMPED);
            metrics.damped_fraction = mean(ticks.map(|k| f64::from(u8::from(damped(k)))));
        }
    }

    /// Computes the force and the motion of the first simulated hand.
    fn hand(&self, metrics: &mut Metrics) {
        let springs = self.experiment.task().file.environment.iter();
        let Some((name, spring)) = springs.into_iter().find_map(|(name, s)| match s {
            EnvironmentObjectParameters::Spring(spring) => Some((name, spring)),
            _ => None,
        }) else {
            return;
        };
        let axes = [WorldAxis::X, WorldAxis::Y, WorldAxis::Z].map(|axis| spring.report.contains(&axis));
        if let Some(truth) = self.recording.channel(TRUTH_CHANNEL)
            && let Some(force) = truth.signal(&signal_names::of(name, FORCE))
        {
            let forces = self.settled(&truth.time_s).map(|k| {
                let force = Vector3::from_column_slice(force.row(k));
                masked_norm(&force, &axes)
            });
            metrics.hand_force_rms_n = rms_and_max(forces).0;
        }
        let Ok(frame) = self.experiment.robot().model.frame_id(&spring.frame) else { return };
        if let Some(home) = self.start_pose(frame) {
            let world = AxesFrame::Fixed(Matrix3::identity());
            let poses = self.poses(ControlledFrame::Frame(frame), world);
            let moved = poses.map(|(_, pose, _)| masked_norm(&(pose.translation - home.translation), &axes));
            metrics.hand_motion_rms_m = rms_and_max(moved).0;
        }
    }

    /// Pose of a frame at the start of control.
    fn start_pose(&self, frame: FrameId) -> Option<Placement> {
        let model = &self.experiment.robot().model;
        let (times, q) = self.joints;
        let k = times.iter().position(|&t| t >= self.start_s - self.same_s)?;
        let mut data = Data::new(model);
        kinematics(model, &mut data, q.row(k), &vec![0.0; model.n()]);
        Some(frame_placement(model, &data, frame))
    }

    /// Computes torque errors √(Σ_j mean e_j²)/√(Σ_j mean τ_desired,j²) with e = τ_motor − τ_desired, over servo
    /// periods; and for each joint, those of the means over the interface intervals.
    fn torque_errors(&self) -> (Metrics, Vec<Relative>) {
        let mut metrics = Metrics::default();
        let Some(servo) = self.recording.channel(SERVO_CHANNEL) else { return (metrics, Vec::new()) };
        let (Some(desired), Some(motor)) = (servo.signal(TORQUE_DESIRED), servo.signal(MOTOR_TORQUE)) else {
            return (metrics, Vec::new());
        };
        let ratio = self.experiment.profile().1.servo_ticks_per_cycle.get() as usize;
        let (mut at_servo, mut at_tick, mut over_interval) =
            (Relative::default(), Relative::default(), Relative::default());
        let n = motor.elements().len();
        let mut sums = vec![(0.0, 0.0); n];
        let mut joints = vec![Relative::default(); n];
        let settled = self.settled(&servo.time_s);
        // The rows consist of whole interface intervals; the first row begins an interval.
        let first = settled.start.div_ceil(ratio) * ratio;
        // There is no desired torque before the first command takes effect, and none after a stop.
        let asked = |k: usize| desired.row(k).iter().all(|d| d.is_finite());
        let whole = |k: &usize| k + ratio <= settled.end && (*k..k + ratio).all(asked);
        for interval in (first..settled.end).step_by(ratio).filter(whole) {
            sums.fill((0.0, 0.0));
            for k in interval..interval + ratio {
                for (j, sum) in sums.iter_mut().enumerate() {
                    let (d, m) = (desired.row(k)[j], motor.row(k)[j]);
                    at_servo.add(d, m);
                    if k == interval {
                        at_tick.add(d, m);
                    }
                    *sum = (sum.0 + d / ratio as f64, sum.1 + m / ratio as f64);
                }
            }
            for (&(d, m), joint) in sums.iter().zip(&mut joints) {
                over_interval.add(d, m);
                joint.add(d, m);
            }
        }
        metrics.torque_error_servo = at_servo.get();
        metrics.torque_error_interval = over_interval.get();
        metrics.torque_error_tick = at_tick.get();
        let within = at_servo.mean_square() - over_interval.mean_square();
        metrics.hold_ripple =
            self.held_ripple_nm().and_then(|held| finite((n as f64 * within).sqrt() / held));
        (metrics, joints)
    }

    /// Ripple √(Σ_j mean e_j²) of the torque that held setpoints cause within interface intervals at the speeds of
    /// the run, Nm. `None` if no setpoint is held for longer than a servo tick, and for velocity robots, whose torque
    /// within an interval depends on acceleration and not on speed.
    fn held_ripple_nm(&self) -> Option<f64> {
        self.experiment.transformer_kind()?;
        if self.experiment.command_kind() != CommandKind::Position {
            return None;
        }
        let (profile, robot) = (self.experiment.profile().1, self.experiment.robot());
        let simulated = robot.file.simulated.as_ref()?;
        if robot.file.interface.setpoints != Setpoints::Held || profile.servo_ticks_per_cycle.get() == 1 {
            return None;
        }
        let servo_period_s = profile.servo_period_s();
        let current_loop_hz = simulated.current_loop_hz.map(Positive::get);
        let ripple_s =
            ripple::of_held_setpoint(profile.servo_ticks_per_cycle.get(), servo_period_s, current_loop_hz);
        let positions = self.recording.channel(TRUTH_CHANNEL).unwrap_or(self.tick);
        let dq = positions.signal(DQ)?;
        let scale = simulated.true_over_nominal.kp.get() * simulated.true_over_nominal.kv.get();
        let true_servos =
            robot.model.joints().iter().filter_map(|joint| {
                simulated.servo.get(&joint.name).or_else(|| profile.servo.get(&joint.name))
            });
        let stiffness: Vec<f64> =
            true_servos.map(|servo| scale * servo.gains(servo_period_s).stiffness).collect();
        let squares = self.settled(&positions.time_s).map(|k| {
            let torque_per_s = stiffness.iter().zip(dq.row(k)).map(|(stiffness, dq)| stiffness * dq);
            torque_per_s.map(|rate| rate * rate).sum::<f64>()
        });
        mean(squares).map(|square| ripple_s * square.sqrt())
    }
}

/// Converts a logged orientation: a quaternion, real part first.
fn orientation(wxyz: &[f64]) -> Matrix3<f64> {
    let quaternion = Quaternion::new(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
    UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix().into_inner()
}

/// Sums of the squares of an error and of the quantity to which it is relative.
#[derive(Clone, Default)]
struct Relative {
    error: f64,
    size: f64,
    count: u64,
}

impl Relative {
    fn add(&mut self, desired: f64, actual: f64) {
        self.error += (actual - desired).powi(2);
        self.size += desired.powi(2);
        self.count += 1;
    }

    fn get(&self) -> Option<f64> {
        finite((self.error / self.size).sqrt())
    }

    fn mean_square(&self) -> f64 {
        self.error / self.count as f64
    }

    /// Rms of the error.
    fn rms(&self) -> Option<f64> {
        finite(self.mean_square().sqrt())
    }
}

fn finite(number: f64) -> Option<f64> {
    number.is_finite().then_some(number)
}

/// Norm over the selected elements.
fn masked_norm(v: &Vector3<f64>, counted: &[bool]) -> f64 {
    v.iter().zip(counted).filter(|(_, counted)| **counted).map(|(x, _)| x * x).sum::<f64>().sqrt()
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = values.fold((0_u64, 0.0), |(count, sum), v| (count + 1, sum + v));
    (count > 0).then(|| sum / count as f64)
}

fn rms_and_max(values: impl Iterator<Item = f64>) -> (Option<f64>, Option<f64>) {
    let mut max = None;
    let squares = values.map(|v| {
        max = Some(max.map_or(v, |m: f64| m.max(v)));
        v * v
    });
    let rms = mean(squares).map(f64::sqrt);
    (rms, max)
}
