//! Bounds on a metric in a task file.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Bounds on a metric; at least one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct Expectation {
    /// Largest value that is accepted, in the unit of the metric.
    #[serde(default)]
    pub at_most: Option<f64>,
    /// Smallest value that is accepted, in the unit of the metric.
    #[serde(default)]
    pub at_least: Option<f64>,
}
