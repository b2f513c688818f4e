//! Metrics of runs, and tables of these metrics.

pub mod baseline;
pub(crate) mod coupling;
pub mod coupling_metrics;
pub mod csv;
pub(crate) mod direction;
pub mod escape_record;
pub mod expectations;
pub(crate) mod failures;
pub(crate) mod harmonics;
pub mod limited_reference;
pub(crate) mod metric_tables;
pub mod metrics;
pub mod notes;
pub mod posture;
pub mod results;
pub(crate) mod spectrum;
pub mod spread;
pub mod table;
pub mod unreached;
