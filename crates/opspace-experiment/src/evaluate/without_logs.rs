//! Runs in simulation without logs: metrics are computed while segments of them pass.

use crate::evaluate::metrics::Evaluator;
use crate::evaluate::run_summary::{CouplingsEvaluator, RunSummary};
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::scenario::Scenario;
use opspace_log::Recording;

impl Scenario {
    /// Runs the scenario in simulation without logs.
    ///
    /// # Errors
    /// A robot that cannot be simulated.
    pub fn run_without_logs(&self, progress: &Progress) -> Result<RunSummary, RunError> {
        let mut evaluators: Vec<Evaluator<'_>> = self.experiments().map(Evaluator::new).collect();
        let mut couplings = CouplingsEvaluator::new(self);
        let outcomes = self.run_in_segments(progress, |number, segment, is_last| {
            evaluators[number].add(segment, is_last);
            couplings.add(number, segment, is_last);
        })?;
        let each = self.experiments().zip(evaluators).zip(outcomes);
        let summaries = each.map(|((experiment, evaluator), (record, realtime_factor))| {
            let recording = Recording::default();
            experiment.summary_of(&recording, evaluator.finish(), &record, Some(realtime_factor))
        });
        Ok(couplings.finish(summaries.collect()))
    }
}
