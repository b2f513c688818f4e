//! Class `Run`: a control loop with its log, stepped by Python.

use crate::control_loop::{signals, step};
use crate::entries::Entries;
use crate::errors::{FaultText, caught, of_log, of_run, refused};
use crate::measured::{Measured, Returned};
use crate::result::{Result, StoredLog};
use crate::simulation::{Arm, Simulation, lock};
use crate::stepping::{LogSink, Stepped, Stepping, TargetValues};
use opspace_backend::Backend;
use opspace_experiment::{Experiment, Progress, RunError};
use opspace_log::{LogFile, Recording};
use opspace_loop::RunOutcome;
use pyo3::prelude::*;
use std::io::Write;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Control loop with a log and a summary: as `ControlLoop`, for the duration of the experiment. `Experiment.start` creates it.
///
/// Call `step` until `over` is true, then `finish`. A run that is deleted without it is interrupted, and its log is complete.
#[pyclass(frozen, module = "opspace")]
pub(crate) struct Run {
    experiment: Arc<Experiment>,
    entries: Entries,
    stepping: Mutex<Option<Stepping>>,
    simulation: Option<Arc<Mutex<Arm>>>,
    path: Option<PathBuf>,
}

impl Run {
    pub(crate) fn new(
        experiment: Arc<Experiment>,
        entries: Entries,
        sink: LogSink,
        path: Option<PathBuf>,
        simulation: Option<&Simulation>,
    ) -> PyResult<Self> {
        let simulation = simulation.map(Simulation::shared);
        let start = || match &simulation {
            Some(arm) => {
                let arm = lock(arm);
                experiment.start_run(
                    arm.arm.capabilities(),
                    arm.arm.ground_truth(),
                    sink,
                    &Progress::default(),
                )
            }
            None => {
                let capabilities = experiment.capabilities().simulated();
                experiment.start_run(&capabilities, None, sink, &Progress::default())
            }
        };
        let run = caught(start)?.map_err(|error| of_run(&error, &[]))?;
        let stepping = Mutex::new(Some(Stepping::new(Stepped::Run(Box::new(run)))));
        Ok(Self { experiment, entries, stepping, simulation, path })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Stepping>> {
        self.stepping.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with<T>(&self, body: impl FnOnce(&mut Stepping) -> PyResult<T>) -> PyResult<T> {
        match &mut *self.lock() {
            Some(stepping) => body(stepping),
            None => Err(refused("the run is finished", None)),
        }
    }
}

#[pymethods]
impl Run {
    /// Computes a cycle and records it, as `ControlLoop.step` does. With a simulation, the true state of the last `read` is
    /// recorded too.
    #[pyo3(signature = (time_s, q, dq=None, motor_torque=None, joint_torque=None, wrenches=None, out=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn step<'py>(
        &self,
        py: Python<'py>,
        time_s: f64,
        q: &Bound<'py, PyAny>,
        dq: Option<&Bound<'py, PyAny>>,
        motor_torque: Option<&Bound<'py, PyAny>>,
        joint_torque: Option<&Bound<'py, PyAny>>,
        wrenches: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Returned<'py>> {
        let measured = Measured { time_s, q, dq, motor_torque, joint_torque, wrenches };
        self.with(|stepping| {
            step(py, stepping, &measured, out, |stepped| {
                if let (Stepped::Run(run), Some(arm)) = (stepped, &self.simulation)
                    && let Some(truth) = lock(arm).arm.ground_truth()
                {
                    run.run().record_truth(truth);
                }
            })
        })
    }

    /// Sets the target of a task, as `ControlLoop.target` does.
    #[pyo3(signature = (task, *, pose=None, twist=None, acceleration=None, wrench=None, gains=None, modes=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn target<'py>(
        &self,
        task: &str,
        pose: Option<&Bound<'py, PyAny>>,
        twist: Option<&Bound<'py, PyAny>>,
        acceleration: Option<&Bound<'py, PyAny>>,
        wrench: Option<&Bound<'py, PyAny>>,
        gains: Option<&Bound<'py, PyAny>>,
        modes: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<()> {
        let values = TargetValues { pose, twist, acceleration, wrench, gains, modes };
        self.with(|stepping| stepping.target(task, &values))
    }

    /// Requests that the robot is held, from the next cycle on; or, with False, that control continues.
    #[pyo3(signature = (hold=true))]
    fn hold(&self, hold: bool) -> PyResult<()> {
        self.with(|stepping| {
            stepping.hold(hold);
            Ok(())
        })
    }

    /// Selects a task set by its number, as `ControlLoop.task_set` does.
    fn task_set(&self, number: u32) -> PyResult<()> {
        self.with(|stepping| {
            stepping.stepped.targets().choose_task_set(number);
            Ok(())
        })
    }

    /// True once no further cycle is needed.
    #[getter]
    fn over(&self) -> bool {
        match &mut *self.lock() {
            Some(Stepping { stepped: Stepped::Run(run), .. }) => run.run().is_over(),
            _ => true,
        }
    }

    /// Phase: "rest", "control", "held", "resuming", "stopping" or "stopped".
    #[getter]
    fn phase(&self) -> &'static str {
        self.lock().as_mut().map_or("stopped", Stepping::phase)
    }

    /// Signals of the last cycle, as in the channel `tick` of a log: a new dictionary of arrays by name.
    fn signals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, pyo3::types::PyDict>> {
        self.with(|stepping| {
            let control = stepping.stepped.control();
            signals(py, control.layout(), control.row())
        })
    }

    /// Ends the run, closes its log and returns its result; a run that is not over is interrupted.
    ///
    /// Raises OpspaceError for a log that could not be written, or a run that was finished before.
    fn finish(&self, py: Python<'_>) -> PyResult<Result> {
        let Some(Stepping { stepped: Stepped::Run(run), .. }) = self.lock().take() else {
            return Err(refused("the run is finished", None));
        };
        let finished = py.detach(|| caught(|| run.finish()))?.map_err(|error| of_run(&error, &[]))?;
        let experiment = &self.experiment;
        let (record, speed) = (finished.record, Some(finished.realtime_factor));
        let (summary, log) = match (finished.sink, &self.path) {
            (LogSink::File(mut file), Some(path)) => {
                let write = |source| of_run(&RunError::Write { path: path.clone(), source }, &[]);
                file.flush().map_err(write)?;
                let log = LogFile::open(path).map_err(|error| of_log(&error, &path.display().to_string()))?;
                let summary = caught(|| experiment.summary_of_file(&log, &record, speed))?;
                (summary.map_err(|error| of_run(&error, &[]))?, StoredLog::Path(path.clone()))
            }
            (LogSink::Memory(bytes), _) => {
                let recording = Recording::from_bytes(&bytes).map_err(|error| of_log(&error, "log"))?;
                (caught(|| experiment.summary(&recording, &record, speed))?, StoredLog::Bytes(bytes.into()))
            }
            (LogSink::File(_), None) => return Err(refused("a log without a path", None)),
        };
        let fault = match finished.outcome {
            RunOutcome::Faulted { fault, time_s } => {
                Some(FaultText::new(&fault, time_s, &experiment.robot().model))
            }
            _ => None,
        };
        Result::new(Arc::clone(experiment), self.entries.clone(), summary, fault, log)
    }
}
