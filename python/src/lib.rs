//! Native module of the Python package `opspace`: models, experiments, logs and the command line.
//!
//! Each class has a file of its own. Classes are frozen, and what changes is behind a lock, so that any thread may use any
//! object. Computations that take long run without Python's lock. A panic becomes an `OpspaceError`.

mod arrays;
mod cli;
mod control_loop;
mod control_loops;
mod entries;
mod errors;
mod experiment;
mod interrupt;
mod log;
mod measured;
mod model;
mod mujoco;
mod python_metric;
mod python_robot;
mod python_task;
mod result;
mod run;
mod simulation;
mod stepping;
mod toml_text;

use pyo3::prelude::*;

/// Module `opspace._opspace`; the package re-exports its names.
#[pymodule]
mod _opspace {
    #[pymodule_export]
    use crate::cli::main;
    #[pymodule_export]
    use crate::control_loop::ControlLoop;
    #[pymodule_export]
    use crate::control_loops::ControlLoops;
    #[pymodule_export]
    use crate::errors::{OpspaceError, RobotFault};
    #[pymodule_export]
    use crate::experiment::{Experiment, Finding, experiment_of_bytes};
    #[pymodule_export]
    use crate::interrupt::{forked, stop_all};
    #[pymodule_export]
    use crate::log::{Channel, Log, Replay, read_log, replay};
    #[pymodule_export]
    use crate::model::{Batch, Model};
    #[pymodule_export]
    use crate::result::{Result, result_of_parts};
    #[pymodule_export]
    use crate::run::Run;
    #[pymodule_export]
    use crate::simulation::Simulation;

    use super::{Bound, PyModule, PyModuleMethods, PyResult};

    /// Adds the version and the defaults of the errors' attributes.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        crate::errors::add_attributes(module.py())
    }
}
