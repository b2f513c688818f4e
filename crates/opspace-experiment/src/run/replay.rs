//! Replay of a log: the control loop receives the logged samples, targets, stop requests and device faults again.

use crate::run::error::RunError;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{COMMAND, DQ_DESIRED, Q_DESIRED, STATUS, TICK_CHANNEL, TORQUE_DESIRED};
use opspace_backend::{Capabilities, Layout, Sink, TICK};
use opspace_log::{Comparer, Difference, LogError, LogFile, LoggedInputs, OutcomeRecord, Recording};
use opspace_loop::{ControlLoop, Run, RunOutcome};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

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
    replay_segments(experiment, recording, |receive| {
        receive(recording, true);
        Ok(())
    })
}

/// Recomputes every row of a log like [`replay`], with one segment of it in memory at a time.
///
/// # Errors
/// As [`replay`]; a log that can no longer be read.
pub fn replay_log(experiment: &Experiment, log: &LogFile) -> Result<ReplayReport, RunError> {
    replay_segments(experiment, log.recording(), |receive| log.for_each_segment(receive))
}

/// Receiver of segments, with true for the last one.
type Receive<'f> = dyn FnMut(&Recording, bool) + 'f;

/// Replays the segments that `pass` passes to its argument. `whole` has layouts and outcome of the log.
fn replay_segments(
    experiment: &Experiment,
    whole: &Recording,
    pass: impl FnOnce(&mut Receive<'_>) -> Result<(), LogError>,
) -> Result<ReplayReport, RunError> {
    let control = experiment.control_loop_for(whole.tick()?.signal(STATUS).is_some())?;
    let inputs = InputsOfLog::new(&control, whole);
    let layout = &whole.tick()?.layout;
    let comparer = Mutex::new(Comparer::new(layout, &Run::layouts(&control, None)[TICK]));
    let (stop, mut sink) = (AtomicBool::new(false), Shared(&comparer));
    let mut run = Run::new(control, experiment.duration_s(), &mut sink).with_stop_request(&stop);
    let mut fed = Ok(());
    pass(&mut |segment, _| {
        let Some(tick) = segment.channel(TICK_CHANNEL).filter(|_| fed.is_ok()) else { return };
        if run.is_over() {
            comparing(&comparer).logged_rows_without_replay(tick.len());
            return;
        }
        for (k, time_s) in tick.time_s.iter().enumerate() {
            comparing(&comparer).logged_row(*time_s, tick.row(k));
        }
        fed = inputs.feed(segment, &mut run, &stop);
    })?;
    fed?;
    let outcome = run.finish();
    Ok(report(&comparing(&comparer), experiment.outcome_record(&outcome)))
}

/// Locks a comparison; one that panicked is not used any more.
fn comparing(comparer: &Mutex<Comparer>) -> MutexGuard<'_, Comparer> {
    comparer.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Comparison that gets the rows of a run while rows of the log reach it too.
struct Shared<'a>(&'a Mutex<Comparer>);

impl Sink for Shared<'_> {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        comparing(self.0).row(channel, time_s, row);
    }
}

/// Description of the inputs of a log.
struct InputsOfLog {
    capabilities: Capabilities,
    targets: Layout,
    outcome: OutcomeRecord,
}

impl InputsOfLog {
    fn new(control: &ControlLoop, log: &Recording) -> Self {
        Self {
            capabilities: control.capabilities().clone(),
            targets: control.targets().layout().clone(),
            outcome: OutcomeRecord::of(log),
        }
    }

    /// Passes the inputs of a segment to a run, up to its end.
    fn feed(&self, segment: &Recording, run: &mut Run<'_>, stop: &AtomicBool) -> Result<(), LogError> {
        let Self { capabilities, targets, outcome } = self;
        let mut inputs = LoggedInputs::of_segment(segment, outcome, capabilities, targets)?;
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
        Ok(())
    }
}

fn report(comparer: &Comparer, outcome: OutcomeRecord) -> ReplayReport {
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
    let (then, now) = (logged.tick()?, run.tick()?);
    let mut comparer = Comparer::new(&then.layout, &now.layout);
    for k in 0..then.len().max(now.len()) {
        if let Some(time_s) = then.time_s.get(k) {
            comparer.logged_row(*time_s, then.row(k));
        }
        if let Some(time_s) = now.time_s.get(k) {
            comparer.row(TICK, *time_s, now.row(k));
        }
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
    let control = experiment.control_loop_for(recording.tick()?.signal(STATUS).is_some())?;
    let inputs = InputsOfLog::new(&control, recording);
    let stop = AtomicBool::new(false);
    let mut run = Run::new(control, experiment.duration_s(), sink).with_stop_request(&stop);
    inputs.feed(recording, &mut run, &stop)?;
    Ok(run.finish())
}
