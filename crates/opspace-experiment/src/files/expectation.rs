//! Bounds on a metric in a task file.

use crate::text::format_number;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Bounds on a metric; at least one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(extend("minProperties" = 1)))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct Expectation {
    /// Largest value that is accepted, in the unit of the metric.
    pub at_most: Option<f64>,
    /// Smallest value that is accepted, in the unit of the metric.
    pub at_least: Option<f64>,
}

impl Expectation {
    /// Describes each bound that a value misses; a value that does not exist misses all.
    pub(crate) fn missed_by(&self, value: Option<f64>) -> impl Iterator<Item = String> {
        let above = self.at_most.filter(|bound| !value.is_some_and(|value| value <= *bound));
        let below = self.at_least.filter(|bound| !value.is_some_and(|value| value >= *bound));
        let bounds = [("at most", above), ("at least", below)];
        bounds.into_iter().filter_map(|(word, bound)| Some(format!("{word} {}", format_number(bound?))))
    }
}
