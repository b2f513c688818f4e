//! Tables of metrics.

pub mod columns;
pub mod coupling_metrics;
pub mod metric;
pub mod metric_tables;
