//! Metrics of a coupling between two robots, and bounds on them.

use crate::files::expectation::Expectation;
use crate::files::source::{FileError, Source};
use crate::suggest::choices;
use crate::text::format_number;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Metrics of a coupling. Positions and forces are those of the leader.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct CouplingMetrics {
    /// Rms distance of the two robots after `settle_s`, while the coupling is closed and the follower touches nothing, m (rad
    /// for joints).
    pub tracking_rms_m: Option<f64>,
    /// Largest such distance, m.
    pub tracking_max_m: Option<f64>,
    /// Mean distance in the last half second, m.
    pub drift_m: Option<f64>,
    /// Largest energy that the pair has given to operator and environment beyond what it had received, J.
    pub energy_extracted_j: Option<f64>,
    /// Rms force of the operator after `settle_s`, N.
    pub hand_force_rms_n: Option<f64>,
    /// Largest rms over 0.25 s of the velocity of one of the frames above 20 Hz, m/s: while the operator probes, or after
    /// `settle_s` without a probe.
    pub fast_velocity_m_per_s: Option<f64>,
    /// Time in which the follower did not touch anything while the operator probed, s.
    pub contact_lost_s: Option<f64>,
    /// Least stiffness that the operator felt at the lines of the probe between 0.5 and 2 Hz, N/m.
    pub felt_least_n_per_m: Option<f64>,
    /// Largest stiffness that the operator felt at these lines, N/m.
    pub felt_largest_n_per_m: Option<f64>,
    /// Least felt stiffness over that of the coupling's spring and the wall in series.
    pub felt_over_series_least: Option<f64>,
    /// Largest felt stiffness over that of the coupling's spring and the wall in series.
    pub felt_over_series_largest: Option<f64>,
    /// Felt stiffness at each line of the probe.
    pub felt: Vec<FeltLine>,
    /// Rms distance of a carried object from its path after `settle_s`, m.
    pub path_rms_m: Option<f64>,
    /// Largest such distance, m.
    pub path_max_m: Option<f64>,
    /// Rms error of the internal force on a carried object after `settle_s`, N: of the vector, across the line between the hands
    /// too.
    pub internal_force_rms_n: Option<f64>,
    /// Largest such error, N.
    pub internal_force_max_n: Option<f64>,
    /// Time for which the passivity control of either side changed something, s.
    pub passivity_time_s: Option<f64>,
    /// Packets that were lost or overtaken, of both directions.
    pub packets_lost: Option<f64>,
}

/// Felt impedance at a frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FeltLine {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Amplitude of the operator's force over that of the leader's motion, N/m.
    pub stiffness_n_per_m: f64,
    /// Phase by which the force leads the motion, rad.
    pub phase_rad: f64,
}

/// Names of the metrics of a coupling.
fn metric_names() -> Vec<String> {
    match serde_json::to_value(CouplingMetrics::default()) {
        Ok(serde_json::Value::Object(map)) => {
            map.into_iter().filter(|(_, value)| !value.is_array()).map(|(name, _)| name).collect()
        }
        _ => Vec::new(),
    }
}

/// Checks that each expectation has a bound, and names a coupling and one of its metrics.
pub(crate) fn check_expectations(
    source: &Source,
    expectations: &BTreeMap<String, Expectation>,
    couplings: &[&str],
) -> Result<(), FileError> {
    for (name, Expectation { at_most, at_least }) in expectations {
        let refuse = |message: String, help: String| {
            Err(FileError::at_key(source, ["expect", name], message, Some(help)))
        };
        if at_most.is_none() && at_least.is_none() {
            return refuse("no bound is given".to_owned(), "add `at_most` or `at_least`".to_owned());
        }
        let (coupling, metric) = name.split_once('.').unwrap_or((name, ""));
        if !couplings.contains(&coupling) {
            return refuse(format!("there is no coupling '{coupling}'"), choices(coupling, couplings));
        }
        let metrics = metric_names();
        if !metrics.iter().any(|known| known == metric) {
            return refuse(format!("unknown metric `{metric}` of a coupling"), choices(metric, &metrics));
        }
    }
    Ok(())
}

/// Describes each expectation that a run missed.
pub(crate) fn missed(
    expectations: &BTreeMap<String, Expectation>,
    couplings: &BTreeMap<String, CouplingMetrics>,
) -> Vec<String> {
    let mut missed = Vec::new();
    for (name, expectation) in expectations {
        let value = name.split_once('.').and_then(|(coupling, metric)| {
            serde_json::to_value(couplings.get(coupling)?).ok()?.get(metric)?.as_f64()
        });
        missed.extend(expectation.missed_by(value).map(|bound| match value {
            Some(value) => format!("{name} is {}, expected {bound}", format_number(value)),
            None => format!("{name} does not exist in this run, expected {bound}"),
        }));
    }
    missed
}
