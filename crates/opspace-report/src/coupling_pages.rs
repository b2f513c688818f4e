//! Pages about runs of several robots, and about suites of them.

use crate::coupling_table::{coupling_notes, coupling_table};
use crate::document::{pictures, run_blocks, with_assumed, with_assumed_lists};
use crate::figure::{Figure, Panel, Series, Style};
use crate::html::Page;
use crate::run_section::RunSection;
use opspace_experiment::evaluate::coupling::FELT_HZ;
use opspace_experiment::evaluate::coupling_sentences::{coupling_sentences, coupling_title};
use opspace_experiment::evaluate::run_summary::RunSummary;
use opspace_experiment::metrics::coupling_metrics::{CouplingMetrics, FeltLine};
use opspace_experiment::run::scenario::Scenario;

/// Builds the page about a run: the couplings, then each robot.
pub(crate) fn coupling_page(
    scenario: &Scenario,
    summary: &RunSummary,
    figures: &[Figure],
    robots: &[(String, RunSection)],
) -> String {
    let mut page = head(
        &coupling_title(summary),
        &format!("Several robots, coupled through channels, in one run, seed {}.", summary.seed),
        &coupling_sentences(summary),
        &format!("Couplings, after the first {} s (settle_s)", scenario.settle_s),
        std::slice::from_ref(summary),
    );
    for failure in summary.failures() {
        page = page.warning(&format!("{failure}."));
    }
    for hold in &summary.holds {
        let until = hold.until_s.map_or_else(|| "the end".to_owned(), |until_s| format!("{until_s:.3} s"));
        page = page.warning(&format!(
            "{} was held from {:.3} s to {until}: {}.",
            hold.robot, hold.from_s, hold.reason
        ));
    }
    page = page.player(&pictures(robots.iter().map(|(name, run)| (name, run))), false);
    for figure in figures {
        page = page.figure(figure);
    }
    if let Some(figure) = felt_figure(summary) {
        page = page.figure(&figure);
    }
    for (name, section) in robots {
        page = run_blocks(page, &format!("{name}: {}", section.title), section);
    }
    let page = page.facts([("experiment", scenario.source.name())]);
    with_assumed_lists(page, summary.robots.values()).render()
}

/// Builds the page about a suite. `pages` are names of runs, and the pages about them, as paths beside this page.
#[must_use]
pub fn coupling_suite_page(title: &str, summaries: &[RunSummary], pages: &[(String, String)]) -> String {
    let lead =
        format!("{} runs of several robots, coupled through channels, in simulation.", summaries.len());
    let mut page = head(title, &lead, &[], "Couplings, after settle_s", summaries);
    for summary in summaries {
        for failure in summary.failures() {
            page = page.warning(&format!("{}: {failure}.", summary.title()));
        }
    }
    if !pages.is_empty() {
        page = page.section("Pages about single runs").facts(pages.iter().map(|(run, page)| (run, page)));
    }
    with_assumed_lists(page, summaries.iter().flat_map(|summary| summary.robots.values())).render()
}

/// Page with the table of the couplings of runs.
fn head(title: &str, lead: &str, story: &[String], caption: &str, summaries: &[RunSummary]) -> Page {
    let notes = coupling_notes(summaries);
    let notes: Vec<&str> = notes.iter().map(String::as_str).collect();
    let robots = summaries.iter().flat_map(|summary| summary.robots.values());
    let page = with_assumed(Page::new(title).story(story).lead(lead), robots);
    page.section("Couplings").table(caption, &coupling_table(summaries), &notes)
}

/// Figure of the felt stiffness over the frequency; `None` without a probe.
fn felt_figure(summary: &RunSummary) -> Option<Figure> {
    let panels: Vec<Panel> = summary
        .couplings
        .iter()
        .filter(|(_, metrics)| !metrics.felt.is_empty())
        .flat_map(|(name, metrics)| {
            let line = |value: fn(&FeltLine) -> f64| {
                let x = metrics.felt.iter().map(|line| line.frequency_hz).collect();
                vec![Series::new("felt", x, metrics.felt.iter().map(value).collect()).style(Style::Solid)]
            };
            let panel = |y_label: &str, series| Panel {
                title: name.clone(),
                x_label: "frequency (Hz)".to_owned(),
                y_label: y_label.to_owned(),
                series,
                ..Panel::default()
            };
            let mut stiffness = line(|line| line.stiffness_n_per_m / 1e3);
            stiffness.extend(in_series(metrics));
            [panel("stiffness (kN/m)", stiffness), panel("phase (rad)", line(|line| line.phase_rad))]
        })
        .collect();
    (!panels.is_empty()).then(|| Figure {
        title: "Felt impedance".to_owned(),
        caption: "Force of the operator over the motion of the leader, at the lines of the probe, and the stiffness of the \
                  coupling's spring and the wall in series. A phase of zero is a spring, half π a damper, and π a mass."
            .to_owned(),
        panels,
        columns: Some(2),
        ..Figure::default()
    })
}

/// Stiffness of the coupling's spring and the wall in series, at the frequencies at which it is compared with the felt one.
fn in_series(metrics: &CouplingMetrics) -> Option<Series> {
    let stiffness_n_per_m = metrics.felt_least_n_per_m? / metrics.felt_over_series_least?;
    let x: Vec<f64> = metrics
        .felt
        .iter()
        .map(|line| line.frequency_hz)
        .filter(|hz| (FELT_HZ[0]..=FELT_HZ[1]).contains(hz))
        .collect();
    let y = vec![stiffness_n_per_m / 1e3; x.len()];
    Some(Series::new("spring and wall in series", x, y).style(Style::Desired))
}
