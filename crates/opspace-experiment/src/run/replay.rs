//! Replay of a log: the control loop receives the logged samples, targets, stop requests and device faults again.

use crate::run::error::RunError;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{COMMAND, DQ_DESIRED, Q_DESIRED, TORQUE_DESIRED};
use opspace_backend::{Sink, TICK};
use opspace_log::{Comparer, Difference, LoggedInputs, OutcomeRecord, Recording};
use opspace_loop::{Run, RunOutcome};
use std::sync::atomic::{AtomicBool, Ordering};

/// The result of a replay.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ReplayReport {
    /// Number of cycles that were compared.
    pub compared: usize,
    /// Number of cycles in the log.
    pub logged: usize,
    /// Number of cycles that differ.
    pub differing: u64,
    /// The first number that differs.
    pub first_difference: Option<Difference>,
    /// Signals that only the log or only the replay has, or that differ in length.
    pub unmatched: Vec<String>,
    /// Outcome of the replay. Interrupted means that the log ends, or that a stop was requested in it.
    pub outcome: OutcomeRecord,
    /// Rms difference between replayed and logged commands, by signal and element, in the units of the signal.
    pub rms: Vec<(String, Vec<(String, f64)>)>,
}

/// The signals that are commands.
const COMMANDS: [&str; 4] = [COMMAND, TORQUE_DESIRED, Q_DESIRED, DQ_DESIRED];

/// Recomputes every row of a log from its inputs and compares it with the log.
///
/// # Errors
/// A log without one of the inputs.
pub fn replay(experiment: &Experiment, recording: &Recording) -> Result<ReplayReport, RunError> {
    let control = experiment.control_loop()?;
    let mut comparer = Comparer::new(recording, &Run::layouts(&control, None)[TICK])?;
    let outcome = replay_into(experiment, recording, &mut comparer)?;
    Ok(report(&comparer, experiment.outcome_record(&outcome)))
}

fn report(comparer: &Comparer<'_>, outcome: OutcomeRecord) -> ReplayReport {
    let rms = COMMANDS.map(|signal| (signal.to_owned(), comparer.rms_difference(signal)));
    ReplayReport {
        compared: comparer.compared(),
        logged: comparer.logged(),
        differing: comparer.differing(),
        first_difference: comparer.first_difference(),
        unmatched: comparer.unmatched().to_vec(),
        outcome,
        rms: rms.into_iter().filter(|(_, elements)| !elements.is_empty()).collect(),
    }
}

/// Compares the rows of a run on a log ([`Experiment::run_on_log`]) with those of the log.
///
/// # Errors
/// A log without control cycles.
pub fn compare_run_on_log(logged: &Recording, run: &Recording) -> Result<ReplayReport, RunError> {
    let tick = run.tick()?;
    let mut comparer = Comparer::new(logged, &tick.layout)?;
    for (k, time_s) in tick.time_s.iter().enumerate() {
        comparer.row(TICK, *time_s, tick.row(k));
    }
    Ok(report(&comparer, OutcomeRecord::of(run)))
}

/// Feeds the inputs of a log to the experiment's control loop and writes its rows to `sink`.
///
/// # Errors
/// As [`replay`].
pub fn replay_into(
    experiment: &Experiment,
    recording: &Recording,
    sink: &mut dyn Sink,
) -> Result<RunOutcome, RunError> {
    let control = experiment.control_loop()?;
    let mut inputs = LoggedInputs::new(recording, control.capabilities(), control.targets().layout())?;
    let stop = AtomicBool::new(false);
    let mut run = Run::new(control, experiment.duration_s(), sink).with_stop_request(&stop);
    while let Some(input) = inputs.next_input()
        && !run.is_over()
    {
        stop.store(input.stop_requested, Ordering::Relaxed);
        run.targets().set_row(input.targets);
        match input.read {
            Ok(sample) => run.cycle(sample),
            Err(fault) => run.fail(fault.clone()),
        };
    }
    Ok(run.finish())
}
