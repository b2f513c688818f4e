//! Table of couplings.

use opspace_experiment::evaluate::run_summary::RunSummary;
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::metrics::coupling_metrics::CouplingMetrics;
use opspace_experiment::run::physics::OWN_PLANT;

/// Column of the table of couplings.
struct CouplingColumn {
    title: &'static str,
    unit: &'static str,
    /// Factor from the metric to the unit.
    factor: f64,
    value: fn(&CouplingMetrics) -> Option<f64>,
    /// The worse of two values.
    worse: fn(f64, f64) -> f64,
}

impl CouplingColumn {
    const fn new(
        (title, unit, factor): (&'static str, &'static str, f64),
        value: fn(&CouplingMetrics) -> Option<f64>,
    ) -> Self {
        Self { title, unit, factor, value, worse: f64::max }
    }

    /// Returns the column with the least value as the worst one.
    const fn least(self) -> Self {
        Self { worse: f64::min, ..self }
    }

    /// Worst value over runs.
    fn worst<'a>(&self, runs: impl Iterator<Item = &'a CouplingMetrics>) -> Option<f64> {
        runs.filter_map(self.value).reduce(self.worse)
    }
}

const COLUMNS: [CouplingColumn; 16] = [
    CouplingColumn::new(("tracking rms", "mm", 1e3), |m| m.tracking_rms_m),
    CouplingColumn::new(("tracking max", "mm", 1e3), |m| m.tracking_max_m),
    CouplingColumn::new(("drift", "mm", 1e3), |m| m.drift_m),
    CouplingColumn::new(("energy extracted", "J", 1.0), |m| m.energy_extracted_j),
    CouplingColumn::new(("hand force rms", "N", 1.0), |m| m.hand_force_rms_n),
    CouplingColumn::new(("velocity above 20 Hz", "mm/s", 1e3), |m| m.fast_velocity_m_per_s),
    CouplingColumn::new(("contact lost", "s", 1.0), |m| m.contact_lost_s),
    CouplingColumn::new(("felt, least", "kN/m", 1e-3), |m| m.felt_least_n_per_m).least(),
    CouplingColumn::new(("felt, largest", "kN/m", 1e-3), |m| m.felt_largest_n_per_m),
    CouplingColumn::new(("over series, least", "", 1.0), |m| m.felt_over_series_least).least(),
    CouplingColumn::new(("over series, largest", "", 1.0), |m| m.felt_over_series_largest),
    CouplingColumn::new(("path rms", "mm", 1e3), |m| m.path_rms_m),
    CouplingColumn::new(("path max", "mm", 1e3), |m| m.path_max_m),
    CouplingColumn::new(("internal force rms", "N", 1.0), |m| m.internal_force_rms_n),
    CouplingColumn::new(("internal force max", "N", 1.0), |m| m.internal_force_max_n),
    CouplingColumn::new(("passivity control", "s", 1.0), |m| m.passivity_time_s),
];

/// Runs of an experiment that differ only in the seed.
type Seeds<'a> = Vec<&'a RunSummary>;

/// Groups runs that differ only in the seed, in the order of the first of each.
#[must_use]
pub fn group_over_seeds(summaries: &[RunSummary]) -> Vec<Vec<&RunSummary>> {
    let mut groups: Vec<Seeds<'_>> = Vec::new();
    for summary in summaries {
        match groups.iter_mut().find(|group| group[0].is_of_same_settings(summary)) {
            Some(group) => group.push(summary),
            None => groups.push(vec![summary]),
        }
    }
    groups
}

/// Table of the couplings of several runs: a row for the runs that differ only in the seed, with the worst value over them.
#[must_use]
pub fn coupling_table(summaries: &[RunSummary]) -> Table {
    let is_shown = |column: &&CouplingColumn| column.worst(all_metrics(summaries)).is_some();
    let shown: Vec<&CouplingColumn> = COLUMNS.iter().filter(is_shown).collect();
    let is_many = summaries.len() > 1;
    let mut heads = vec![("coupling", "")];
    if is_many {
        heads = vec![("settings", ""), ("profile", ""), ("runs", ""), ("coupling", "")];
    }
    heads.extend(shown.iter().map(|column| (column.title, column.unit)));
    heads.extend([("packets lost", ""), ("result", "")]);
    let mut table = Table::new(&heads);
    let mut experiment = None;
    for runs in group_over_seeds(summaries) {
        let first = runs[0];
        if is_many && experiment.replace(&first.experiment) != Some(&first.experiment) {
            // Missing cells at the end of a row stay blank.
            table.push(vec![first.experiment.clone().into()]);
        }
        for name in first.couplings.keys() {
            let metrics = || runs.iter().filter_map(|run| run.couplings.get(name));
            let mut row: Vec<Cell> = Vec::new();
            if is_many {
                row.push(format!("  {}", settings(first)).into());
                row.push(profiles(first).into());
                row.push((runs.len() as u64).into());
            }
            row.push(name.clone().into());
            row.extend(shown.iter().map(|column| {
                column.worst(metrics()).map_or(Cell::Empty, |value| Cell::Number(value * column.factor))
            }));
            let lost = metrics().filter_map(|m| m.packets_lost).reduce(f64::max);
            row.push(lost.map_or(Cell::Empty, |lost| Cell::Count(lost as u64)));
            row.push(result(&runs));
            table.push(row);
        }
    }
    table
}

fn all_metrics(summaries: &[RunSummary]) -> impl Iterator<Item = &CouplingMetrics> {
    summaries.iter().flat_map(|summary| summary.couplings.values())
}

/// Name of the settings, and of the plant if it is not the library's own.
fn settings(summary: &RunSummary) -> String {
    let plant = Some(summary.plant()).filter(|plant| !plant.is_empty() && *plant != OWN_PLANT);
    let parts: Vec<&str> = summary.label.as_deref().into_iter().chain(plant).collect();
    if parts.is_empty() { "as in the file".to_owned() } else { parts.join(", ") }
}

/// Profile of the robots, once if all have the same one.
fn profiles(summary: &RunSummary) -> String {
    let mut profiles: Vec<&str> = summary.robots.values().map(|robot| robot.profile.as_str()).collect();
    profiles.dedup();
    profiles.join(", ")
}

fn result(runs: &Seeds<'_>) -> Cell {
    let failed = runs.iter().filter(|run| run.has_failed()).count();
    match (failed, runs.len()) {
        (0, _) if runs.iter().any(|run| run.is_interrupted()) => Cell::Fail("interrupted".to_owned()),
        (0, _) => Cell::Pass("ok".to_owned()),
        (_, 1) => Cell::Fail("failed".to_owned()),
        (failed, runs) => Cell::Fail(format!("{failed} of {runs} failed")),
    }
}

/// Notes about the table of couplings.
#[must_use]
pub fn coupling_notes(summaries: &[RunSummary]) -> Vec<String> {
    let mut notes: Vec<String> = [
        "Tracking and drift: distance of the robots in the leader's coordinates, also with a delay.",
        "Energy extracted: most that the pair has given to operator and environment beyond what it had received.",
        "Felt: force of the operator over the motion of the leader at the lines of the probe from 0.5 to 2 Hz; over series: \
         relative to the spring of the coupling and the wall in series.",
    ]
    .map(str::to_owned)
    .into();
    if group_over_seeds(summaries).len() < summaries.len() {
        let worst = "Each number is the worst one over the runs of its row, which differ only in the seed: the least one in \
                     `felt, least` and `over series, least`, and the largest one in all other columns.";
        notes.push(worst.to_owned());
    }
    notes
}
