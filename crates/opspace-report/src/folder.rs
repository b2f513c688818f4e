//! Folder of a run: log, summary and report.

use crate::document::{RunSection, page};
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::run::error::RunError;
use opspace_experiment::run::execute::RunResult;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::result_files::{LOG, REPORT, ResultFolder, SUMMARY, write_file};
use opspace_log::{LogError, LogFile, OutcomeRecord};
use serde::Serialize;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// Log of a run that is about to begin.
#[derive(Debug)]
pub(crate) struct NewLog {
    path: PathBuf,
    file: File,
}

impl NewLog {
    /// Creates the log in a folder, and returns it with a handle for writing. Both handles denote the file that is open here,
    /// even if another one takes its path.
    pub(crate) fn create(folder: &ResultFolder) -> Result<(Self, BufWriter<File>), RunError> {
        let path = folder.path().join(LOG);
        let created = File::options().read(true).write(true).create_new(true).open(&path);
        let unwritable = |source| RunError::Write { path: path.clone(), source };
        let file = created.map_err(unwritable)?;
        let writer = BufWriter::new(file.try_clone().map_err(unwritable)?);
        Ok((Self { path, file }, writer))
    }

    /// Returns another handle of the log.
    pub(crate) fn again(&self) -> Result<Self, RunError> {
        let file = self.file.try_clone();
        let file = file.map_err(|source| RunError::Write { path: self.path.clone(), source })?;
        Ok(Self { path: self.path.clone(), file })
    }

    /// Removes the log of a run that did not begin.
    pub(crate) fn discard(&self) {
        let log = self.file.try_clone().map(|file| LogFile::from_file(file, &self.path));
        if matches!(log, Ok(Err(LogError::NotMcap | LogError::NoChannel { .. }))) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Calls `run` with a new log file in `folder`, then writes summary and report to the same folder. An existing
/// log is never overwritten.
///
/// ```no_run
/// use opspace_experiment::{Experiment, Progress, RunError};
/// use opspace_report::folder::in_folder;
///
/// fn record(experiment: &Experiment) -> Result<(), RunError> {
///     let summary = in_folder(experiment, "runs/mine".as_ref(), |log| experiment.run(log, &Progress::default()))?;
///     assert_eq!(summary.faulted, None);
///     Ok(())
/// }
/// ```
///
/// # Errors
/// The error of `run`; a folder that already contains a log; files that cannot be written.
pub fn in_folder(
    experiment: &Experiment,
    folder: &Path,
    run: impl FnOnce(BufWriter<File>) -> Result<RunResult<BufWriter<File>>, RunError>,
) -> Result<Summary, RunError> {
    in_locked_folder(experiment, &ResultFolder::open(folder)?, run)
}

/// Runs the experiment as [`in_folder`] does, in a folder that the caller has locked.
///
/// An existing log is never overwritten. The summary is computed from the open log, whatever becomes of its path.
/// Files that cannot be written completely are listed in [`Summary::not_saved`]; a log that was cut short, by a full
/// disk for example, is summarised as far as it was written.
///
/// # Errors
/// That of the run; a folder that already holds a log; a log that can't be created or read back.
pub fn in_locked_folder(
    experiment: &Experiment,
    folder: &ResultFolder,
    run: impl FnOnce(BufWriter<File>) -> Result<RunResult<BufWriter<File>>, RunError>,
) -> Result<Summary, RunError> {
    let (log, file) = NewLog::create(folder)?;
    finish_folder(experiment, folder, log, run(file))
}

/// Writes summary and report of a run to its folder; `written` is the result of the run that wrote the log.
pub(crate) fn finish_folder(
    experiment: &Experiment,
    folder: &ResultFolder,
    log: NewLog,
    written: Result<RunResult<BufWriter<File>>, RunError>,
) -> Result<Summary, RunError> {
    match written {
        Ok(result) => {
            let recorded = LogFile::from_file(log.file, &log.path)?;
            let summary =
                experiment.summary_of_file(&recorded, &result.record, Some(result.realtime_factor))?;
            write_pages(experiment, folder, &recorded, summary, Vec::new())
        }
        Err(RunError::LogCutShort { record, rows, source }) => {
            let recorded = LogFile::from_file(log.file, &log.path)?;
            let mut summary = experiment.summary_of_file(&recorded, &record, None)?;
            summary.rows_lost = rows.saturating_sub(recorded.row_count());
            write_pages(experiment, folder, &recorded, summary, vec![format!("{LOG}: {source}")])
        }
        Err(error) => {
            log.discard();
            Err(error)
        }
    }
}

/// Writes summary and report of a run whose log was closed from another thread.
pub(crate) fn finish_left_behind(
    experiment: &Experiment,
    folder: &ResultFolder,
    log: NewLog,
    record: &OutcomeRecord,
) -> Result<Summary, RunError> {
    let recorded = LogFile::from_file(log.file, &log.path)?;
    let summary = experiment.summary_of_file(&recorded, record, None)?;
    write_pages(experiment, folder, &recorded, summary, Vec::new())
}

/// Writes report and summary, and returns the summary with the files that could not be written.
fn write_pages(
    experiment: &Experiment,
    folder: &ResultFolder,
    log: &LogFile,
    mut summary: Summary,
    not_saved: Vec<String>,
) -> Result<Summary, RunError> {
    summary.not_saved = not_saved;
    let shown = RunSection::of_file(experiment, log, summary.clone())?;
    let lead = "Desired and actual behaviour of the robot in one run.";
    let columns = default_columns(experiment.task().tables.added());
    let html = page(&shown.title.clone(), lead, std::slice::from_ref(&summary), &columns, &[shown]);
    summary.not_saved.extend(save(folder.path(), REPORT, &html));
    summary.not_saved.extend(save_summary(folder.path(), &summary)?);
    Ok(summary)
}

/// Writes a file of results; returns its name with the cause if it cannot be written.
pub(crate) fn save(folder: &Path, name: &str, text: &str) -> Option<String> {
    write_file(&folder.join(name), text).err().map(|error| format!("{name}: {error}"))
}

/// Writes a summary as [`save`] does.
pub(crate) fn save_summary(folder: &Path, summary: &impl Serialize) -> Result<Option<String>, RunError> {
    let json = serde_json::to_string_pretty(summary)
        .map_err(|error| RunError::Write { path: folder.join(SUMMARY), source: error.into() })?;
    Ok(save(folder, SUMMARY, &(json + "\n")))
}
