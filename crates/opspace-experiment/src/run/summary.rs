//! The summary of a run: a row of a table, and `summary.json`.

use crate::evaluate::metrics::{Metrics, Timing, metrics, timing};
use crate::run::experiment::Experiment;
use crate::run::log_header::is_real;
use opspace_log::{OutcomeRecord, Recording};
use opspace_loop::Phase;
use serde::Serialize;

/// The summary of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The task's name.
    pub task: String,
    /// The robot's name.
    pub robot: String,
    /// `position` or `torque`.
    pub backend: String,
    /// `osc`, `ik` or `ik-lead`.
    pub controller: String,
    /// The transformer; `None` where there is none.
    pub transformer: Option<String>,
    /// Why it is that one.
    pub transformer_reason: Option<String>,
    /// The robot's profile.
    pub profile: String,
    /// Servo ticks per interface tick.
    pub ratio: u32,
    /// Of everything random.
    pub seed: u64,
    /// Whether the robot was simulated.
    pub simulated: bool,
    /// How long the controller was to run, s.
    pub duration_s: f64,
    /// The settings that changed the files.
    pub overrides: Vec<String>,
    /// What a suite calls these settings.
    pub label: Option<String>,
    /// The cause of a stop.
    pub faulted: Option<String>,
    /// When it stopped, s.
    pub fault_time_s: Option<f64>,
    /// Whether it was asked to stop.
    pub interrupted: bool,
    /// Time at which it was asked to stop, s.
    pub interrupted_time_s: Option<f64>,
    /// Rows lost on the way to the log.
    pub rows_lost: u64,
    /// Interface cycles in which no sample came.
    pub missed_cycles: u64,
    /// Control cycles in which a streamed target was stale.
    pub stale_target_cycles: u64,
    /// How often control was resumed after a dropout.
    pub resumed: u64,
    /// How well it went.
    pub metrics: Metrics,
    /// How long things took: not reproducible.
    pub timing: Timing,
}

impl Experiment {
    /// The summary of a run of this experiment, from its log.
    #[must_use]
    pub fn summary(
        &self,
        recording: &Recording,
        outcome: &OutcomeRecord,
        realtime_factor: Option<f64>,
    ) -> Summary {
        let (missed_cycles, resumed) = continuity(recording);
        Summary {
            task: self.task().name(),
            robot: self.robot().name(),
            backend: self.choice().backend.name().to_owned(),
            controller: self.choice().controller.name().to_owned(),
            transformer: self.transformer_kind().map(|kind| kind.name().to_owned()),
            transformer_reason: self.transformer_reason(),
            profile: self.profile().0.to_owned(),
            ratio: self.profile().1.ratio.get(),
            seed: self.seed(),
            simulated: !is_real(recording),
            duration_s: self.duration_s(),
            overrides: self.settings().to_vec(),
            label: self.choice().label.clone(),
            faulted: outcome.fault.clone(),
            fault_time_s: outcome.time_s.filter(|_| outcome.fault.is_some()),
            interrupted: outcome.interrupted,
            interrupted_time_s: outcome.time_s.filter(|_| outcome.interrupted),
            rows_lost: recording.dropped(),
            missed_cycles,
            stale_target_cycles: stale_target_cycles(recording),
            resumed,
            metrics: metrics(self, recording),
            timing: timing(recording, realtime_factor),
        }
    }
}

/// The number of missed cycles in a log, and the number of times control was resumed.
fn continuity(recording: &Recording) -> (u64, u64) {
    let Some(tick) = recording.channel("tick") else { return (0, 0) };
    let missed = tick.signal("missed_cycles").map_or(0.0, |missed| missed.rows().map(|row| row[0]).sum());
    let resuming = Phase::Resuming.code();
    let resumed = tick.signal("phase").map_or(0, |phase| {
        (1..phase.len()).filter(|&k| phase.row(k)[0] == resuming && phase.row(k - 1)[0] != resuming).count()
    });
    (missed as u64, resumed as u64)
}

/// The number of control cycles in a log in which a streamed target of some task was stale.
fn stale_target_cycles(recording: &Recording) -> u64 {
    let Some(tick) = recording.channel("tick") else { return 0 };
    let names = tick.layout.signals.iter().map(|signal| signal.name.as_str());
    let stale: Vec<_> =
        names.filter(|name| name.ends_with(".target_stale")).filter_map(|n| tick.signal(n)).collect();
    let rows = tick.time_s.len();
    (0..rows).filter(|&k| stale.iter().any(|stale| stale.row(k)[0] == 1.0)).count() as u64
}
