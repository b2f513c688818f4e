//! Run that owns its log, for a program that is called once per cycle.

use crate::run::error::RunError;
use crate::run::execute::{LogCloser, Progress, RunResult};
use crate::run::experiment::Experiment;
use opspace_backend::{Capabilities, GroundTruth, TruthLayouts};
use opspace_log::LogError;
use opspace_loop::Run;
use std::io::{self, Write};
use std::sync::Arc;

/// Run of an experiment together with its log. It borrows nothing: an object of another language, a vendor's callback or an
/// environment of a learning program can keep it, and step it from any thread. One that is dropped without
/// [`finish`](Self::finish) is ended as by it, but errors of the log are lost.
pub struct OwnedRun<W> {
    run: Run<'static>,
    /// Closer of the log, until the run is finished.
    closer: Option<LogCloser<W>>,
    experiment: Experiment,
}

impl<W> Drop for OwnedRun<W> {
    fn drop(&mut self) {
        if let Some(closer) = self.closer.take() {
            let _ = self.close(closer);
        }
    }
}

impl<W> OwnedRun<W> {
    /// Ends the run, drops its end of the log, and closes the log.
    fn close(&mut self, closer: LogCloser<W>) -> Result<RunResult<W>, RunError> {
        let outcome = self.run.end();
        closer.close(&self.experiment, outcome)
    }
}

impl<W: Write + Send + 'static> OwnedRun<W> {
    /// The run: call [`Run::cycle`] once per interface cycle until [`Run::is_over`].
    pub fn run(&mut self) -> &mut Run<'static> {
        &mut self.run
    }

    /// The experiment that runs.
    #[must_use]
    pub fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    /// Ends the run and closes its log; a run that was not over is interrupted.
    ///
    /// # Errors
    /// If the log cannot be written.
    pub fn finish(mut self) -> Result<RunResult<W>, RunError> {
        match self.closer.take() {
            Some(closer) => self.close(closer),
            None => Err(LogError::Write(io::Error::other("the log is already closed")).into()),
        }
    }
}

impl Experiment {
    /// Starts a run that owns its log, and that the caller steps. `truth` is that of a simulated robot, whose rows the caller
    /// passes on with [`Run::record_truth`]. `progress` receives cycles, and its stop requests are those of the run.
    ///
    /// # Errors
    /// As [`run_on`](Self::run_on), but the start position is not checked.
    pub fn start_run<W: Write + Send + 'static>(
        &self,
        capabilities: &Capabilities,
        truth: Option<&dyn GroundTruth>,
        sink: W,
        progress: &Progress,
    ) -> Result<OwnedRun<W>, RunError> {
        let layouts: Option<TruthLayouts> = truth.map(GroundTruth::layouts);
        let (control, log) = self.open(capabilities, layouts, sink, progress)?;
        let closer = log.closer();
        let mut run = Run::new(control, self.duration_s(), log)
            .with_stop_request(Arc::clone(&progress.interrupt))
            .with_abort_request(Arc::clone(&progress.abort));
        if let Some(truth) = truth {
            run.prepare_truth(truth);
        }
        Ok(OwnedRun { run, closer: Some(closer), experiment: self.clone() })
    }
}
