//! Metrics of runs, summaries, and tables of metrics.

pub mod coupling;
pub mod coupling_sentences;
pub mod direction;
pub(crate) mod failures;
pub mod felt_force;
pub mod findings;
pub mod grid_keys;
pub(crate) mod harmonics;
pub mod headline;
pub mod metrics;
pub mod notes;
pub mod other_transformer;
pub mod position_control;
pub mod posture;
pub(crate) mod remedies;
pub mod response_sentences;
pub mod response_table;
pub mod results;
pub mod run_summary;
pub mod run_table;
pub mod spectrum;
pub mod spread;
pub(crate) mod springs;
pub mod summary;
pub mod table;
mod without_logs;
