//! Expectations of an experiment with several robots: bounds on metrics of its couplings.

use crate::files::expectation::Expectation;
use crate::files::source::{FileError, Source};
use crate::metrics::coupling_metrics::CouplingMetrics;
use crate::suggest::choices;
use crate::text::format_number;
use std::collections::BTreeMap;

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
