//! Folders of results: log, summary and report of a run.

pub mod folder;
mod move_to_start;
mod scenario_run;
