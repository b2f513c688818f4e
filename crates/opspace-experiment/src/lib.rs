//! Robot and task files, experiments assembled from them, suites, metrics and reports.

#![forbid(unsafe_code)]

pub mod evaluate;
pub mod extensions;
pub mod files;
pub mod identify;
pub mod preflight;
pub mod report;
pub mod run;

pub use evaluate::metrics::{Metrics, Timing};
pub use extensions::Extensions;
pub use files::origin::Files;
pub use files::robot::Robot;
pub use files::source::{FileError, Source};
pub use files::suite::Suite;
pub use files::task::Task;
pub use files::task_kinds::{TaskKindError, TaskKinds};
pub use preflight::{Finding, findings};
pub use run::error::RunError;
pub use run::execute::{Progress, RunResult};
pub use run::experiment::{BackendKind, Choice, ControllerKind, Experiment};
pub use run::summary::Summary;
