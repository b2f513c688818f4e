//! Folder of a run: log, summary and report.

use crate::evaluate::results::MEASURES;
use crate::report::document::{RunSection, page};
use crate::run::error::RunError;
use crate::run::execute::RunResult;
use crate::run::experiment::Experiment;
use crate::run::summary::Summary;
use opspace_log::Recording;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::Path;

/// File name of a run's log.
pub const LOG: &str = "run.mcap";
/// File name of the page of a run or a suite.
pub const REPORT: &str = "report.html";
/// File name of a run's summary.
pub const SUMMARY: &str = "summary.json";

impl Experiment {
    /// Calls `run` with a new log file in `folder`, then writes summary and report to the same folder. An existing
    /// log is never overwritten.
    ///
    /// ```no_run
    /// use opspace_experiment::{Experiment, Progress, RunError};
    ///
    /// fn record(experiment: &Experiment) -> Result<(), RunError> {
    ///     let summary = experiment.in_folder("runs/mine".as_ref(), |log| experiment.run(log, &Progress::default()))?;
    ///     assert_eq!(summary.faulted, None);
    ///     Ok(())
    /// }
    /// ```
    ///
    /// # Errors
    /// The error of `run`; a folder that already contains a log; files that cannot be written.
    pub fn in_folder(
        &self,
        folder: &Path,
        run: impl FnOnce(BufWriter<File>) -> Result<RunResult<BufWriter<File>>, RunError>,
    ) -> Result<Summary, RunError> {
        let failed = |path: &Path, source: io::Error| RunError::Write { path: path.to_owned(), source };
        fs::create_dir_all(folder).map_err(|e| failed(folder, e))?;
        let log = folder.join(LOG);
        let file = File::create_new(&log).map_err(|e| failed(&log, e))?;
        let result = run(BufWriter::new(file))?;
        let recording = Recording::read(&log)?;
        let summary = self.summary(&recording, &result.record, Some(result.realtime_factor));
        let shown = RunSection::new(self, &recording, summary.clone());
        let lead = "Desired and actual behaviour of the robot in one run.";
        let html = page(&shown.title.clone(), lead, std::slice::from_ref(&summary), MEASURES, &[shown]);
        let json =
            serde_json::to_string_pretty(&summary).map_err(|e| failed(&folder.join(SUMMARY), e.into()))?;
        for (name, text) in [(REPORT, html), (SUMMARY, json + "\n")] {
            let path = folder.join(name);
            fs::write(&path, text).map_err(|e| failed(&path, e))?;
        }
        Ok(summary)
    }
}
