//! Reports: pages with a table of runs, charts that compare them, and the figures of each run.

use crate::evaluate::results::{Measure, group, joint_table, notes, table, task_table};
use crate::report::comparisons::{comparisons, overlays, sweeps};
use crate::report::html::Page;
pub use crate::report::run_section::RunSection;
use crate::run::summary::Summary;

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
