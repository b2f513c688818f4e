//! Tables of metrics, and the bounds on them that files state.

pub mod coupling_metrics;
pub(crate) mod expectations;
pub(crate) mod metric_tables;
