//! Folders of results: log, summary and report of a run.

pub mod folder;
mod move_to_start;
pub mod other_transformer;
mod scenario_run;
