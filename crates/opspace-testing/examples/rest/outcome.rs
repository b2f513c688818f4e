//! Motion at the end of a run.

use crate::cases::{ARRIVAL_S, Case, GoalKind, SETTLING_S};
use opspace_backend::signal_names::{COMMAND, DQ, Q, TORQUE_DESIRED};
use opspace_experiment::Progress;
use opspace_log::Recording;
use std::fmt;
use std::io::Cursor;

/// True speed below which an arm is at rest, rad/s.
const REST: f64 = 1e-3;

/// Motion of an arm while it is observed.
pub struct Outcome {
    /// Highest true speed of a joint, rad/s.
    pub speed: f64,
    /// Largest mean rate of a desired torque over the joint's torque limit, 1/s.
    pub torque_rate: f64,
    pub fault: Option<String>,
    /// Error of the task at the end, and after a descent from there, m.
    residual: (f64, f64),
    /// Joint positions at the end.
    pub end: Vec<f64>,
}

impl Outcome {
    pub fn of(case: &Case, goal: &GoalKind) -> Self {
        let experiment = case.experiment(goal);
        let is_unreachable = matches!(goal, GoalKind::Unreachable);
        let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run");
        if let (Ok(folder), true) = (std::env::var("REST_LOG"), is_unreachable) {
            std::fs::write(format!("{folder}/{}.mcap", case.number), finished.sink.get_ref())
                .expect("written");
        }
        let log = Recording::from_bytes(finished.sink.get_ref()).expect("a log");
        let truth = log.channel("truth").expect("the true state");
        let tick = log.tick().expect("rows");
        let from = ((ARRIVAL_S + SETTLING_S) / (experiment.duration_s() / truth.len() as f64)) as usize;
        let from = from.min(truth.len().saturating_sub(2));
        let dq = truth.signal(DQ).expect("true velocities");
        let speed = (from..dq.len()).flat_map(|k| dq.row(k)).fold(0.0_f64, |m, v| m.max(v.abs()));
        let torque = tick.signal(TORQUE_DESIRED).or(tick.signal(COMMAND)).expect("torques");
        let limits = experiment.robot().torque_limits();
        let period = experiment.duration_s() / tick.len() as f64;
        let mut torque_rate = 0.0_f64;
        for (i, limit) in limits.iter().enumerate() {
            let torques = || (from..torque.len()).map(|k| torque.row(k)[i]);
            let sum: f64 = torques().zip(torques().skip(1)).map(|(a, b)| (b - a).abs()).sum();
            let observed_s = (torque.len() - from) as f64 * period;
            torque_rate = torque_rate.max(sum / observed_s / limit);
        }
        let q = truth.signal(Q).expect("true positions");
        let end = q.row(q.len() - 1).to_vec();
        let fault = finished.record.fault.clone();
        let collision = experiment.kept_distances().map(|kept| &kept.limits);
        let residual = if is_unreachable { case.residual(&end, collision) } else { (0.0, 0.0) };
        Self { speed, torque_rate, fault, residual, end }
    }

    /// Returns true if the arm rests, or moves no more than the same arm at a reachable goal.
    pub fn rests(&self, near: &Self) -> bool {
        self.fault.is_none()
            && self.speed < REST.max(2.0 * near.speed)
            && self.torque_rate <= (2.0 * near.torque_rate).max(0.01)
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:8.1e} rad/s {:8.1e}/s", self.speed, self.torque_rate)?;
        if self.residual.0 > 0.0 {
            write!(f, " {:.4} {:+.4} m", self.residual.0, self.residual.1 - self.residual.0)?;
        }
        if let Some(fault) = &self.fault {
            write!(f, " {fault}")?;
        }
        Ok(())
    }
}
