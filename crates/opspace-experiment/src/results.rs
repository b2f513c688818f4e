//! Folders of results: log, summary and report of a run.

mod coupled_drivers;
pub mod coupled_run;
pub mod folder;
mod move_to_start;
