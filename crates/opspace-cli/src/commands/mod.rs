//! Commands, one file each.

pub mod bench;
pub mod check;
pub mod completion;
pub mod doctor;
pub mod driver;
pub mod driver_read;
pub mod explain;
pub mod export_path;
pub mod identify;
pub mod log;
pub mod margins;
pub mod merge;
pub mod model;
pub mod new;
pub mod posture;
pub mod replay;
pub mod report;
pub mod run;
pub mod run_in_view;
pub mod run_on_log;
pub mod schema;
pub mod simulate_log;
pub mod view;
