//! Section of a page about one run.

use crate::report::figure::Figure;
use crate::report::run_figures::RunFigures;
use crate::run::error::RunError;
use crate::run::experiment::Experiment;
use crate::run::log_header;
use crate::run::summary::Summary;
use opspace_log::{LogFile, RECOVERED, Recording};

/// Section of a page about one run, with all its figures.
#[derive(Clone, Debug)]
pub struct RunSection {
    /// Title of the run, in one line.
    pub title: String,
    /// Summary of the run.
    pub summary: Summary,
    /// Figures of the run.
    pub figures: Vec<Figure>,
    /// Warnings about the log: damage, lost rows.
    pub warnings: Vec<String>,
    /// Origin of the run: files, seed, versions.
    pub facts: Vec<(String, String)>,
}

impl RunSection {
    /// Creates the section of a run from its log.
    #[must_use]
    pub fn new(experiment: &Experiment, recording: &Recording, summary: Summary) -> Self {
        let mut figures = RunFigures::new(experiment);
        figures.add(recording, true);
        Self::with_figures(recording, figures.finish(), summary)
    }

    /// Creates the section of a run from its log, which is read in segments.
    ///
    /// # Errors
    /// If the log can no longer be read.
    pub fn of_file(experiment: &Experiment, log: &LogFile, summary: Summary) -> Result<Self, RunError> {
        let mut figures = RunFigures::new(experiment);
        log.for_each_segment(&mut |segment, is_last| figures.add(segment, is_last))?;
        Ok(Self::with_figures(log.recording(), figures.finish(), summary))
    }

    fn with_figures(recording: &Recording, figures: Vec<Figure>, summary: Summary) -> Self {
        let mut warnings = Vec::new();
        if let Some(damage) = &recording.damage {
            let shown = if damage.rows_lost { "; only the readable part is shown" } else { "" };
            warnings.push(format!("The log is damaged{shown}: {damage}."));
        }
        if recording.dropped() > 0 {
            warnings.push(format!("{} rows were dropped and are not in the log.", recording.dropped()));
        }
        if recording.metadata(RECOVERED).is_some() {
            warnings.push("The log was recovered from a damaged one: the run may have gone on.".to_owned());
        }
        warnings.extend(summary.failures.iter().map(|failure| format!("Failure: {failure}.")));
        warnings.extend(
            summary.missed_expectations.iter().map(|missed| format!("Expectation missed: {missed}.")),
        );
        if let Some(fault) = &summary.faulted {
            let time = summary.fault_time_s.unwrap_or(f64::NAN);
            warnings.push(format!("The run was stopped at {time:.3} s: {fault}."));
        }
        // Entries for a replay; a robot without a transformer has none to be shown.
        let has_transformer = summary.transformer.is_some();
        let is_shown =
            |key: &str| key != log_header::ASKED_FOR && (has_transformer || !key.starts_with("transformer"));
        let metadata = recording.metadata(log_header::RUN).into_iter().flatten();
        let facts = metadata.filter(|(key, value)| is_shown(key) && !value.is_empty());
        Self {
            title: title(&summary),
            figures,
            summary,
            warnings,
            facts: facts.map(|(key, value)| (key.clone(), value.clone())).collect(),
        }
    }
}

fn title(summary: &Summary) -> String {
    let by = summary.transformer.as_ref().map_or_else(String::new, |t| format!(" through '{t}'"));
    format!(
        "{}: {} robot, {}{by}, {} 1:{}, seed {}",
        summary.task, summary.backend, summary.controller, summary.profile, summary.ratio, summary.seed
    )
}
