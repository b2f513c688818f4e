//! Fractions of the control cycles, and the largest torques and speeds.

use super::run_log::{Mean, Run, finite};
use crate::files::controller_kind::ControllerKind;
use crate::metrics::metric_tables::Metrics;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{
    self, COMMAND, DQ, LEAST_DISTANCE, LIMITS_SOLVER, MIN_SINGULAR_GAIN, MISSED_CYCLES,
    SETPOINT_ACCELERATION, SETPOINT_CLAMPED, SETPOINT_LIMITED, SETPOINT_SPEED, TORQUE_SATURATED,
    TRUTH_CHANNEL,
};
use opspace_log::Column;

/// Largest gain of a damped inverse that counts as damped: 1 is undamped, except for rounding.
const UNDAMPED: f64 = 1.0 - 1e-9;

/// Sums over the control cycles of a run.
pub(super) struct Cycles {
    commands_torques: bool,
    count: u64,
    missed: Option<f64>,
    saturated: Mean,
    limited: Mean,
    damped: Mean,
    least_distance: Option<f64>,
    setpoints_limited: Option<u64>,
    setpoints_clamped: Option<u64>,
    setpoint_speed: Option<f64>,
    setpoint_acceleration: Option<f64>,
    torque: Option<f64>,
    torque_step: Option<f64>,
    speed: Option<f64>,
    /// Command of the cycle before.
    command: Vec<f64>,
}

impl Cycles {
    pub(super) fn new(experiment: &Experiment) -> Self {
        Self {
            commands_torques: experiment.options().controller == ControllerKind::Osc,
            count: 0,
            missed: None,
            saturated: Mean::default(),
            limited: Mean::default(),
            damped: Mean::default(),
            least_distance: None,
            setpoints_limited: None,
            setpoints_clamped: None,
            setpoint_speed: None,
            setpoint_acceleration: None,
            torque: None,
            torque_step: None,
            speed: None,
            command: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        let (all, ticks) = (run.settled_ticks(), run.counted_ticks());
        let signal = |name: &str| run.tick.signal(name);
        self.count += all.len() as u64;
        if let Some(missed) = signal(MISSED_CYCLES) {
            let counts = all.clone().map(|k| missed.row(k)[0]).filter(|count| count.is_finite());
            self.missed = Some(self.missed.unwrap_or(0.0) + counts.sum::<f64>());
        }
        if let Some(saturated) = signal(TORQUE_SATURATED) {
            let any = |k: usize| saturated.row(k).iter().copied().fold(0.0, f64::max);
            ticks.clone().for_each(|k| self.saturated.add(any(k)));
        }
        if let Some(solver) = signal(LIMITS_SOLVER) {
            ticks.clone().for_each(|k| self.limited.add(f64::from(u8::from(solver.row(k)[0] != 0.0))));
        }
        if let Some(distance) = signal(LEAST_DISTANCE) {
            let all = ticks.clone().map(|k| distance.row(k)[0]).filter(|distance| distance.is_finite());
            self.least_distance = all.chain(self.least_distance).reduce(f64::min);
        }
        let suffix = signal_names::of("", MIN_SINGULAR_GAIN);
        let names = run.tick.layout.signals.iter().map(|signal| signal.name.as_str());
        let gains: Vec<Column<'_>> =
            names.filter(|name| name.ends_with(&suffix)).filter_map(signal).collect();
        if !gains.is_empty() {
            let damped = |k: usize| gains.iter().any(|gain| gain.row(k)[0] < UNDAMPED);
            ticks.clone().for_each(|k| self.damped.add(f64::from(u8::from(damped(k)))));
        }
        for (name, largest) in [
            (SETPOINT_SPEED, &mut self.setpoint_speed),
            (SETPOINT_ACCELERATION, &mut self.setpoint_acceleration),
        ] {
            if let Some(values) = signal(name) {
                let magnitudes = ticks.clone().flat_map(|k| values.row(k)).map(|value| value.abs());
                *largest = Some(magnitudes.fold(largest.unwrap_or(0.0), f64::max));
            }
        }
        if let Some(clamped) = signal(SETPOINT_CLAMPED) {
            let count = clamped.rows().flatten().filter(|clamped| **clamped == 1.0).count() as u64;
            self.setpoints_clamped = Some(self.setpoints_clamped.unwrap_or(0) + count);
        }
        let positions = run.recording.channel(TRUTH_CHANNEL).unwrap_or(run.tick);
        if let Some(limited) = positions.signal(SETPOINT_LIMITED) {
            let joints = (0..positions.len()).flat_map(|k| limited.row(k));
            let count = joints.filter(|limited| **limited != 0.0).count() as u64;
            self.setpoints_limited = Some(self.setpoints_limited.unwrap_or(0) + count);
        }
        if let Some(dq) = positions.signal(DQ) {
            run.counted(&positions.time_s).for_each(|k| enlarge(&mut self.speed, dq.row(k).iter().copied()));
        }
        if let Some(command) = signal(COMMAND).filter(|_| self.commands_torques) {
            for k in ticks {
                let now = command.row(k);
                enlarge(&mut self.torque, now.iter().copied());
                let steps = now.iter().zip(&self.command).map(|(now, before)| now - before);
                enlarge(&mut self.torque_step, steps);
                self.command.clear();
                self.command.extend_from_slice(now);
            }
        }
    }

    pub(super) fn finish(self, metrics: &mut Metrics) {
        metrics.missed_fraction =
            self.missed.and_then(|missed| finite(missed / (missed + self.count as f64)));
        metrics.torque_saturated_share = self.saturated.get();
        metrics.limited_share = self.limited.get();
        metrics.damped_fraction = self.damped.get();
        metrics.least_distance_m = self.least_distance;
        metrics.setpoints_limited = self.setpoints_limited;
        metrics.setpoints_clamped = self.setpoints_clamped;
        metrics.setpoint_speed_max_rad_per_s = self.setpoint_speed;
        metrics.setpoint_acceleration_max_rad_per_s2 = self.setpoint_acceleration;
        metrics.torque_commanded_max_nm = self.torque;
        metrics.torque_step_max_nm = self.torque_step;
        metrics.speed_max_rad_per_s = self.speed;
    }
}

/// Takes the largest magnitude of finite values where it exceeds that so far.
fn enlarge(largest: &mut Option<f64>, values: impl Iterator<Item = f64>) {
    *largest = values.filter(|value| value.is_finite()).map(f64::abs).chain(*largest).reduce(f64::max);
}
