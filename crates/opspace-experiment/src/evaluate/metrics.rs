//! Metrics of a run, computed only from its log.
//!
//! Statistics cover the time from `settle_s` after the first control cycle to the last control cycle; the start of
//! the robot's clock does not matter. Positions are the true ones if the log contains them (simulation), otherwise
//! the measured ones.

mod chatter;
mod joints;
mod ripple;
pub(crate) mod run_log;
pub(crate) mod tasks;

pub use crate::evaluate::metric_tables::{
    Compliance, Contact, ElementError, Evaluation, JointMetrics, Metrics, PoseErrors, TaskMetrics, Timing,
};

use crate::run::experiment::{ControllerKind, Experiment};
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::Positive;
use opspace_backend::signal_names::{
    self, COMMAND, DQ, FORCE, LIMITS_SOLVER, MIN_SINGULAR_GAIN, MISSED_CYCLES, MOTOR_TORQUE, PHASE,
    SERVO_CHANNEL, SETPOINT_ACCELERATION, SETPOINT_SPEED, TICK_CHANNEL, TICK_TIME, TIMING_CHANNEL,
    TORQUE_DESIRED, TORQUE_SATURATED, TRUTH_CHANNEL,
};
use opspace_backend::{CommandKind, Setpoints};
use opspace_control::{AxesFrame, ControlledFrame};
use opspace_log::Recording;
use opspace_sim::{EnvironmentObjectParameters, WorldAxis};
use run_log::{Relative, Run, finite, masked_norm, mean, rms_and_max};

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
        if self.pose == PoseErrors::default() {
            self.pose = task.pose;
        }
        if self.contact == Contact::default() {
            self.contact = task.contact;
        }
        if self.compliance == Compliance::default() {
            self.compliance = task.compliance;
        }
        self.joint_rms_rad = self.joint_rms_rad.or(task.joint_rms_rad);
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

/// Durations of the control cycles of a log, in ascending order, ns.
pub(crate) fn cycle_times_ns(recording: &Recording) -> Vec<f64> {
    let mut ticks: Vec<f64> = Vec::new();
    if let (Some(tick), Some(timing)) = (recording.channel(TICK_CHANNEL), recording.channel(TIMING_CHANNEL))
        && let (Some(phase), Some(time)) = (tick.signal(PHASE), timing.signal(TICK_TIME))
    {
        // Rows belong together that have the same time; a cycle without a computed command has no row in `timing`.
        let mut cycles = tick.time_s.iter().zip(phase.rows()).peekable();
        for (time_s, elapsed) in timing.time_s.iter().zip(time.rows()) {
            while cycles.next_if(|(cycle_s, _)| *cycle_s < time_s).is_some() {}
            let controlled = cycles.peek().is_some_and(|(cycle_s, p)| *cycle_s == time_s && p[0] == 1.0);
            ticks.extend(controlled.then_some(elapsed[0]));
        }
    }
    ticks.sort_by(f64::total_cmp);
    ticks
}

/// Computes the statistics of the control cycles' durations from a log.
#[must_use]
pub fn timing(recording: &Recording, realtime_factor: Option<f64>) -> Timing {
    let ticks = cycle_times_ns(recording);
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

impl<'a> Run<'a> {
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
