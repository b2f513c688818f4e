//! Page about a suite of experiments with several robots.

use crate::evaluate::coupled_summary::CoupledSummary;
use crate::report::coupled_table::{coupling_notes, coupling_table};
use crate::report::document::with_assumed;
use crate::report::html::Page;

/// Builds the page about a suite. `pages` are names of runs, and the pages about them, as paths beside this page.
#[must_use]
pub fn coupled_suite_page(title: &str, summaries: &[CoupledSummary], pages: &[(String, String)]) -> String {
    let notes = coupling_notes(summaries);
    let notes: Vec<&str> = notes.iter().map(String::as_str).collect();
    let head = Page::new(title).lead(&format!(
        "{} runs of several robots, coupled through channels, in simulation.",
        summaries.len()
    ));
    let mut page = with_assumed(head, summaries.iter().flat_map(|summary| summary.robots.values()))
        .section("Couplings")
        .table("Couplings, after settle_s", &coupling_table(summaries), &notes);
    for summary in summaries {
        for failure in summary.failures() {
            page = page.warning(&format!("{}: {failure}.", summary.title()));
        }
    }
    if !pages.is_empty() {
        page = page.section("Pages about single runs").facts(pages.iter().map(|(run, page)| (run, page)));
    }
    page.render()
}
