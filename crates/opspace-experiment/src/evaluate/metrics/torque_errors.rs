//! Errors of the motor torques, at servo rate and over the interface intervals.

use super::ripple;
use super::run_log::{Mean, Relative, Run, finite};
use crate::metrics::metric_tables::Metrics;
use crate::run::experiment::Experiment;
use opspace_backend::quantity::Positive;
use opspace_backend::signal_names::{DQ, MOTOR_TORQUE, SERVO_CHANNEL, TORQUE_DESIRED, TRUTH_CHANNEL};
use opspace_backend::{CommandKind, Setpoints};

/// Torque errors √(Σ_j mean e_j²)/√(Σ_j mean τ_desired,j²) with e = τ_motor − τ_desired, over servo periods; and for each
/// joint, those of the means over the interface intervals.
pub(super) struct TorqueErrors {
    /// Number of servo periods of an interface interval.
    ratio: usize,
    /// Number of rows before the segment. The rows consist of whole interface intervals.
    rows_before: usize,
    /// Desired and motor torques of the present interval, row by row, and the number of its rows.
    interval: Vec<(f64, f64)>,
    in_interval: usize,
    at_servo: Relative,
    at_tick: Relative,
    over_interval: Relative,
    joints: Vec<Relative>,
    held: Option<HeldRipple>,
}

/// Ripple √(Σ_j mean e_j²) of the torque that held setpoints cause within interface intervals at the speeds of the run.
struct HeldRipple {
    ripple_s: f64,
    /// Stiffness of each servo, Nm/rad.
    stiffness: Vec<f64>,
    /// Squares of the rates of change of the torques, (Nm/s)².
    squares: Mean,
}

impl TorqueErrors {
    pub(super) fn new(experiment: &Experiment) -> Self {
        let n = experiment.robot().model.n();
        Self {
            ratio: experiment.profile().1.servo_ticks_per_cycle.get() as usize,
            rows_before: 0,
            interval: Vec::new(),
            in_interval: 0,
            at_servo: Relative::default(),
            at_tick: Relative::default(),
            over_interval: Relative::default(),
            joints: vec![Relative::default(); n],
            held: HeldRipple::new(experiment),
        }
    }

    /// Counts the rows of a segment that is not evaluated.
    pub(super) fn skip(&mut self, recording: &opspace_log::Recording) {
        self.rows_before += recording.channel(SERVO_CHANNEL).map_or(0, opspace_log::ChannelData::len);
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        if let Some(held) = &mut self.held {
            held.add(run);
        }
        let Some(servo) = run.recording.channel(SERVO_CHANNEL) else { return };
        if let (Some(desired), Some(motor)) = (servo.signal(TORQUE_DESIRED), servo.signal(MOTOR_TORQUE)) {
            for k in run.counted(&servo.time_s) {
                self.add_row(self.rows_before + k, desired.row(k), motor.row(k));
            }
        }
        self.rows_before += servo.len();
    }

    /// Adds a row with its number in the log. An interval counts if it is complete and has a desired torque throughout:
    /// there is none before the first command takes effect, and after a stop.
    fn add_row(&mut self, number: usize, desired: &[f64], motor: &[f64]) {
        let place = number % self.ratio;
        if place == 0 {
            self.interval.clear();
            self.in_interval = 0;
        }
        if place != self.in_interval || !desired.iter().all(|torque| torque.is_finite()) {
            return;
        }
        self.interval.extend(desired.iter().copied().zip(motor.iter().copied()));
        self.in_interval += 1;
        if self.in_interval == self.ratio {
            self.add_interval(desired.len());
        }
    }

    fn add_interval(&mut self, n: usize) {
        for (k, &(desired, motor)) in self.interval.iter().enumerate() {
            self.at_servo.add(desired, motor);
            if k < n {
                self.at_tick.add(desired, motor);
            }
        }
        for j in 0..n {
            let (mut desired, mut motor) = (0.0, 0.0);
            for (d, m) in self.interval.iter().skip(j).step_by(n) {
                desired += d / self.ratio as f64;
                motor += m / self.ratio as f64;
            }
            self.over_interval.add(desired, motor);
            if let Some(joint) = self.joints.get_mut(j) {
                joint.add(desired, motor);
            }
        }
    }

    /// Sets the torque errors of a run, and returns those of its joints over the interface intervals.
    pub(super) fn finish(self, metrics: &mut Metrics) -> Vec<Relative> {
        metrics.torque_error_servo = self.at_servo.get();
        metrics.torque_error_interval = self.over_interval.get();
        metrics.torque_error_tick = self.at_tick.get();
        let within = self.at_servo.mean_square() - self.over_interval.mean_square();
        let held_nm = self.held.and_then(HeldRipple::rms_nm);
        metrics.hold_ripple =
            held_nm.and_then(|held_nm| finite((self.joints.len() as f64 * within).sqrt() / held_nm));
        self.joints
    }
}

impl HeldRipple {
    /// Returns `None` if no setpoint is held for longer than a servo tick, and for velocity robots, whose torque within
    /// an interval depends on acceleration and not on speed.
    fn new(experiment: &Experiment) -> Option<Self> {
        experiment.transformer_name()?;
        if experiment.command_kind() != CommandKind::Position {
            return None;
        }
        let (profile, robot) = (experiment.profile().1, experiment.robot());
        let simulated = robot.file.simulated.as_ref()?;
        if robot.file.interface.setpoints != Setpoints::Held || profile.servo_ticks_per_cycle.get() == 1 {
            return None;
        }
        let servo_period_s = profile.servo_period_s();
        let current_loop_hz = simulated.current_loop_hz.map(Positive::get);
        let scale = simulated.true_over_nominal.kp.get() * simulated.true_over_nominal.kv.get();
        let true_servos =
            robot.model.joints().iter().filter_map(|joint| {
                simulated.servo.get(&joint.name).or_else(|| profile.servo.get(&joint.name))
            });
        Some(Self {
            ripple_s: ripple::of_held_setpoint(
                profile.servo_ticks_per_cycle.get(),
                servo_period_s,
                current_loop_hz,
            ),
            stiffness: true_servos.map(|servo| scale * servo.gains(servo_period_s).stiffness).collect(),
            squares: Mean::default(),
        })
    }

    fn add(&mut self, run: &Run<'_>) {
        let positions = run.recording.channel(TRUTH_CHANNEL).unwrap_or(run.tick);
        let Some(dq) = positions.signal(DQ) else { return };
        for k in run.counted(&positions.time_s) {
            let torque_per_s = self.stiffness.iter().zip(dq.row(k)).map(|(stiffness, dq)| stiffness * dq);
            self.squares.add(torque_per_s.map(|rate| rate * rate).sum::<f64>());
        }
    }

    fn rms_nm(self) -> Option<f64> {
        self.squares.get().map(|square| self.ripple_s * square.sqrt())
    }
}
