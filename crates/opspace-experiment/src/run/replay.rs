//! A log run again: the same loop, controller and transformer on the logged measurements.

use crate::run::execute::RunError;
use crate::run::experiment::Experiment;
use opspace_backend::Sink;
use opspace_log::{Comparer, Difference, Recording, ReplayRobot};
use opspace_loop::Ending;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// What a replay found.
#[derive(Clone, Debug, PartialEq)]
pub struct Replayed {
    /// How many ticks were compared.
    pub compared: usize,
    /// How many ticks the log has.
    pub logged: usize,
    /// How many of them differ.
    pub differing: u64,
    /// The first number that differs.
    pub first_difference: Option<Difference>,
    /// Signals that only the log or only the replay has, or that differ in length.
    pub unmatched: Vec<String>,
    /// Root mean square difference from the log of what was commanded: signal, then element by element.
    pub rms: Vec<(String, Vec<(String, f64)>)>,
}

/// The signals that are commands.
const COMMANDS: [&str; 3] = ["command", "torque_desired", "q_desired"];

/// Recomputes every command of a log from its measurements, and compares.
///
/// # Errors
/// A log without what a replay needs.
pub fn replay(experiment: &Experiment, recording: &Recording) -> Result<Replayed, RunError> {
    let (_, comparer) = run_again(experiment, recording, |layout| Comparer::new(recording, layout))?;
    let rms = COMMANDS.map(|signal| (signal.to_owned(), comparer.rms_difference(signal)));
    Ok(Replayed {
        compared: comparer.compared(),
        logged: comparer.logged(),
        differing: comparer.differing(),
        first_difference: comparer.first_difference(),
        unmatched: comparer.unmatched().to_vec(),
        rms: rms.into_iter().filter(|(_, elements)| !elements.is_empty()).collect(),
    })
}

/// How the run of a log ended. Of a log that was cut off nothing is known but that it went on up to there.
///
/// # Errors
/// As [`replay`].
pub fn ending(experiment: &Experiment, recording: &Recording) -> Result<Ending, RunError> {
    struct Nowhere;
    impl Sink for Nowhere {
        fn row(&mut self, _channel: usize, _time_s: f64, _row: &[f64]) {}
    }
    let (ending, _) = run_again(experiment, recording, |_| Ok(Nowhere))?;
    Ok(match ending {
        Ending::Faulted { fault: opspace_loop::Fault::EndOfLog, .. } => Ending::Completed,
        ending => ending,
    })
}

fn run_again<S: Sink>(
    experiment: &Experiment,
    recording: &Recording,
    sink: impl FnOnce(&opspace_backend::Layout) -> Result<S, opspace_log::LogError>,
) -> Result<(Ending, S), RunError> {
    let interrupt = Arc::new(AtomicBool::new(false));
    let n = experiment.robot().model.n();
    let robot = ReplayRobot::new(recording, n, experiment.facts(), Arc::clone(&interrupt))?;
    let mut backend = experiment.backend(robot)?;
    let mut controller = experiment.controller()?;
    let mut control = experiment.control_loop(&mut *backend, &mut *controller);
    let mut sink = sink(&control.layouts()[opspace_backend::TICK])?;
    let ending = control.run(experiment.duration_s(), &interrupt, &mut sink);
    Ok((ending, sink))
}
