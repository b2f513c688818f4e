//! Robot and task files, experiments assembled from them, runs and metrics.
//!
//! ```
//! use opspace_experiment::run::replay::replay;
//! use opspace_experiment::{RunOptions, Experiment, Files, Progress};
//! use opspace_log::Recording;
//! use std::io::Cursor;
//!
//! // A task file names its robot; `Files::Disk` reads files of your own.
//! let task = "tasks/cartesian-tracking.toml".as_ref();
//! let options = RunOptions { duration_s: Some(2.0), ..RunOptions::default() };
//! let experiment = Experiment::load(Files::Embedded, task, None, options, &[])?;
//!
//! // Run in simulation and log to memory; a `File` works too.
//! let result = experiment.run(Cursor::new(Vec::new()), &Progress::default())?;
//! let log = Recording::from_bytes(result.sink.get_ref())?;
//! let summary = experiment.summary(&log, &result.record, None);
//! assert_eq!(summary.faulted, None);
//! assert!(summary.metrics.pose.position_rms_m.ok_or("a Cartesian task")? < 1e-3);
//!
//! // Every row of the log is recomputed from its inputs, bit for bit.
//! let report = replay(&experiment, &log)?;
//! assert_eq!((report.compared as u64, report.differing), (experiment.ticks(), 0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod codes;
pub mod evaluate;
pub mod extensions;
pub mod files;
pub mod finding;
pub mod metrics;
pub mod plants;
pub mod postures;
pub mod run;
pub mod suggest;
pub mod text;
pub mod transformers;

pub use codes::Code;
pub use evaluate::metrics::{Metrics, Timing};
pub use evaluate::run_summary::RunSummary;
pub use evaluate::summary::Summary;
pub use extensions::{Entry, Extensions, NameTaken, Tables, UnknownName};
pub use files::controller_kind::ControllerKind;
pub use files::origin::Files;
pub use files::robot::RobotDefinition;
pub use files::source::{FileError, Source};
pub use files::task::TaskDefinition;
pub use files::task_kinds::TaskKind;
pub use finding::{Causes, Finding, Place};
pub use metrics::metric::{Better, Column, LogMetric, Metric};
pub use plants::PlantEntry;
pub use run::companion::Companion;
pub use run::companion_entry::CompanionEntry;
pub use run::error::RunError;
pub use run::execute::{Progress, RunResult};
pub use run::experiment::{Experiment, RunOptions};
pub use run::scenario::Scenario;
pub use transformers::entry::{TransformerEntry, TransformerTraits};
pub use transformers::setup::TransformerSetup;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
