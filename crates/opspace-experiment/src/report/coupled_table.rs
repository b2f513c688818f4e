//! Table of couplings.

use crate::evaluate::coupling_metrics::CouplingMetrics;
use crate::evaluate::table::{Cell, Table};
use crate::run::coupled_summary::CoupledSummary;

/// Columns of the table of couplings: title, unit, factor to the unit, and value.
type CouplingColumn = (&'static str, &'static str, f64, fn(&CouplingMetrics) -> Option<f64>);

const COLUMNS: [CouplingColumn; 16] = [
    ("tracking rms", "mm", 1e3, |m| m.tracking_rms_m),
    ("tracking max", "mm", 1e3, |m| m.tracking_max_m),
    ("drift", "mm", 1e3, |m| m.drift_m),
    ("energy extracted", "J", 1.0, |m| m.energy_extracted_j),
    ("hand force rms", "N", 1.0, |m| m.hand_force_rms_n),
    ("velocity above 20 Hz", "mm/s", 1e3, |m| m.fast_velocity_m_per_s),
    ("contact lost", "s", 1.0, |m| m.contact_lost_s),
    ("felt, least", "kN/m", 1e-3, |m| m.felt_least_n_per_m),
    ("felt, largest", "kN/m", 1e-3, |m| m.felt_largest_n_per_m),
    ("over series, least", "", 1.0, |m| m.felt_over_series_least),
    ("over series, largest", "", 1.0, |m| m.felt_over_series_largest),
    ("path rms", "mm", 1e3, |m| m.path_rms_m),
    ("path max", "mm", 1e3, |m| m.path_max_m),
    ("internal force rms", "N", 1.0, |m| m.internal_force_rms_n),
    ("internal force max", "N", 1.0, |m| m.internal_force_max_n),
    ("passivity control", "s", 1.0, |m| m.passivity_time_s),
];

/// Table of the couplings of several runs.
#[must_use]
pub fn coupling_table(summaries: &[CoupledSummary]) -> Table {
    let shown: Vec<&CouplingColumn> = COLUMNS
        .iter()
        .filter(|(.., value)| summaries.iter().any(|s| s.couplings.values().any(|m| value(m).is_some())))
        .collect();
    let is_many = summaries.len() > 1;
    let mut heads = vec![("coupling", "")];
    if is_many {
        heads = vec![("experiment", ""), ("settings", ""), ("seed", ""), ("coupling", "")];
    }
    heads.extend(shown.iter().map(|(title, unit, ..)| (*title, *unit)));
    heads.extend([("packets lost", ""), ("result", "")]);
    let mut table = Table::new(&heads);
    for summary in summaries {
        for (name, metrics) in &summary.couplings {
            let mut row = Vec::new();
            if is_many {
                row.push(Cell::Text(summary.experiment.clone()));
                row.push(summary.label.clone().map_or(Cell::Empty, Cell::Text));
                row.push(Cell::Count(summary.seed));
            }
            row.push(Cell::Text(name.clone()));
            for (.., factor, value) in &shown {
                row.push(value(metrics).map_or(Cell::Empty, |value| Cell::Number(value * factor)));
            }
            row.push(metrics.packets_lost.map_or(Cell::Empty, |lost| Cell::Count(lost as u64)));
            row.push(if summary.has_failed() {
                Cell::Fail("failed".to_owned())
            } else {
                Cell::Pass("ok".to_owned())
            });
            table.push(row);
        }
    }
    table
}

/// Notes about the table of couplings.
#[must_use]
pub fn coupling_notes() -> Vec<String> {
    [
        "Tracking and drift: distance of the robots in the leader's coordinates, also with a delay.",
        "Energy extracted: most that the pair has given to operator and environment beyond what it had received.",
        "Felt: force of the operator over the motion of the leader at the lines of the probe from 0.5 to 2 Hz; over series: \
         relative to the spring of the coupling and the wall in series.",
    ]
    .map(str::to_owned)
    .into()
}
