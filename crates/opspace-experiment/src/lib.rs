//! Robot and task files, experiments assembled from them, suites, metrics and reports.

pub mod experiment;
pub mod figure;
pub mod files;
pub mod findings;
pub mod identify;
pub mod metrics;
pub mod names;
pub mod overrides;
pub mod page;
mod place;
pub mod replay;
pub mod report;
pub mod results;
pub mod robot;
pub mod run;
pub mod source;
pub mod suite;
pub mod table;
pub mod task;
pub mod template;
pub mod tool;
mod words;

pub use experiment::{BackendKind, Choice, ControllerKind, Experiment};
pub use files::Files;
pub use findings::{Finding, findings};
pub use metrics::{Metrics, Timing};
pub use robot::Robot;
pub use run::{RunError, Summary};
pub use source::{FileError, Source};
pub use suite::Suite;
pub use task::Task;
