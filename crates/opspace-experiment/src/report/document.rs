//! Reports: pages with a table of runs, charts that compare them, and the figures of each run.

use crate::evaluate::results::{Measure, group, joint_table, notes, table, task_table};
use crate::report::comparisons::{comparisons, overlays, sweeps};
use crate::report::figure::Figure;
use crate::report::html::Page;
use crate::report::run_figures::figures;
use crate::run::experiment::Experiment;
use crate::run::log_header;
use crate::run::summary::Summary;
use opspace_log::Recording;

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
        let mut warnings = Vec::new();
        if let Some(damage) = &recording.damage {
            let shown = if damage.rows_lost { "; only the readable part is shown" } else { "" };
            warnings.push(format!("The log is damaged{shown}: {damage}."));
        }
        if recording.dropped() > 0 {
            warnings.push(format!("{} rows were dropped and are not in the log.", recording.dropped()));
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
            figures: figures(experiment, recording),
            summary,
            warnings,
            facts: facts.map(|(key, value)| (key.clone(), value.clone())).collect(),
        }
    }
}

/// Builds a page about runs: one table, then a section for each run in `shown`.
#[must_use]
pub fn page(
    title: &str,
    lead: &str,
    summaries: &[Summary],
    measures: &[Measure],
    shown: &[RunSection],
) -> String {
    let mut page = Page::new(title).lead(lead).section("Results").table(
        if group(summaries).iter().all(|group| group.runs.len() == 1) {
            "Values after settle_s"
        } else {
            "Medians over the seeds of each row, and their intervals, after settle_s"
        },
        &table(summaries, measures),
        &notes(summaries),
    );
    if summaries.len() > 1 {
        for comparison in comparisons(summaries) {
            page = page.comparison(&comparison);
        }
        for figure in sweeps(summaries).into_iter().chain(overlays(shown)) {
            page = page.figure(&figure);
        }
    }
    for run in shown {
        page = page.section(&run.title);
        for warning in &run.warnings {
            page = page.warning(warning);
        }
        let (tasks, joints) = (task_table(&run.summary), joint_table(&run.summary));
        for (caption, table) in [
            ("Errors of the tasks", tasks),
            ("Torques of the joints; chatter is the desired torque above 8 Hz", joints),
        ] {
            if !table.rows.is_empty() {
                page = page.table(caption, &table, &[]);
            }
        }
        for figure in &run.figures {
            page = page.figure(figure);
        }
        page = page.facts(run.facts.iter().map(|(term, text)| (term.as_str(), text.as_str())));
    }
    page.render()
}

fn title(summary: &Summary) -> String {
    let by = summary.transformer.as_ref().map_or_else(String::new, |t| format!(" through '{t}'"));
    format!(
        "{}: {} robot, {}{by}, {} 1:{}, seed {}",
        summary.task, summary.backend, summary.controller, summary.profile, summary.ratio, summary.seed
    )
}
