//! Times of the events of a run.

use opspace_backend::signal_names::TASK_SET;
use opspace_experiment::evaluate::metrics::run_log::Run;
use opspace_experiment::run::experiment::Experiment;

/// Times of the events of a run while segments of its log arrive: those in the task file, or, where contact decides, those
/// at which the active task set changed.
pub(crate) struct EventTimes<'a> {
    experiment: &'a Experiment,
    /// Number of the active set at the end of the last segment.
    set: f64,
    changes_s: Vec<f64>,
}

impl<'a> EventTimes<'a> {
    pub(crate) fn new(experiment: &'a Experiment) -> Self {
        Self { experiment, set: 0.0, changes_s: Vec::new() }
    }

    /// Adds the changes of a segment.
    pub(crate) fn add(&mut self, run: &Run<'_>) {
        let Some(set) = run.tick.signal(TASK_SET) else { return };
        for (k, time_s) in run.tick.time_s.iter().enumerate() {
            let number = set.row(k)[0];
            if number.is_finite() && number != self.set {
                self.set = number;
                self.changes_s.push(((time_s - run.start_s) * 1e3).round() / 1e3);
            }
        }
    }

    /// Times since the start of control, s.
    pub(crate) fn finish(self) -> Vec<f64> {
        let events = &self.experiment.task().events;
        if events.iter().any(|event| event.contact.is_some()) {
            return self.changes_s;
        }
        events.iter().map(|event| event.time_s).collect()
    }
}
