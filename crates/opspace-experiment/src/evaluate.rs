//! Metrics of a run, and tables of them.

pub mod metrics;
pub mod results;
pub mod table;
