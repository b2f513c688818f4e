//! Table of the metrics of a run, and their columns.

use crate::extensions::Entry;
use crate::metrics::metric::{Column, Metric};
use crate::metrics::metric_tables::{Metrics, Timing};
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Deserialize;
#[cfg(feature = "schema")]
use serde_json::{Value, json};
#[cfg(feature = "schema")]
use std::borrow::Cow;
use std::sync::LazyLock;

impl Entry for Metric {
    const KIND: &'static str = "metric";

    fn built_in() -> &'static [Self] {
        static ROWS: LazyLock<Vec<Metric>> =
            LazyLock::new(|| Metrics::rows().into_iter().chain(Timing::rows()).collect());
        &ROWS
    }

    fn name(&self) -> &str {
        self.key
    }

    fn shares_a_name(&self, other: &Self) -> bool {
        self.column.zip(other.column).is_some_and(|(own, other)| own.name == other.name)
    }
}

/// Metrics with a column, built-in and added.
pub fn with_columns(added: &[Metric]) -> impl Iterator<Item = (&Metric, Column)> {
    <Metric as Entry>::built_in().iter().chain(added).filter_map(|metric| Some((metric, metric.column?)))
}

/// Name of a column in a suite file.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(transparent)]
pub struct ColumnName(pub String);

#[cfg(feature = "schema")]
impl JsonSchema for ColumnName {
    fn schema_name() -> Cow<'static, str> {
        "ColumnName".into()
    }

    fn json_schema(_generator: &mut SchemaGenerator) -> Schema {
        column_schema(&[])
    }
}

/// Schema of the name of a column, of a built-in or added metric.
#[cfg(feature = "schema")]
#[must_use]
pub fn column_schema(added: &[Metric]) -> Schema {
    let name = |(metric, column): (&Metric, Column)| json!({ "description": metric.meaning, "type": "string", "const": column.name });
    let names: Vec<Value> = with_columns(added).map(name).collect();
    json_schema!({ "description": "Column of a table of results.", "oneOf": names })
}

/// Metrics of the columns with these names.
///
/// # Errors
/// The place of the first unknown name.
pub fn columns_named<'a>(
    names: impl IntoIterator<Item = &'a str>,
    added: &[Metric],
) -> Result<Vec<Metric>, usize> {
    let find = |(place, name): (usize, &str)| {
        let found = with_columns(added).find(|(_, column)| column.name == name);
        found.map(|(metric, _)| metric.clone()).ok_or(place)
    };
    names.into_iter().enumerate().map(find).collect()
}

/// Metrics of the tables that do not list their columns.
#[must_use]
pub fn default_columns(added: &[Metric]) -> Vec<Metric> {
    with_columns(added).filter(|(_, column)| column.by_default).map(|(metric, _)| metric.clone()).collect()
}
