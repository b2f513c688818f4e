//! Metrics of runs, and tables of these metrics.

pub mod metrics;
pub mod results;
pub mod table;
