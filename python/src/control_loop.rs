//! Class `ControlLoop`: the control loop of an experiment, stepped by Python.

use crate::errors::{caught, of_file};
use crate::measured::{Measured, Returned, output, returned};
use crate::stepping::{Stepped, Stepping, TargetValues};
use numpy::PyArray1;
use opspace_experiment::Experiment;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Control loop of an experiment, without input, output or clock: Python calls `step` once per cycle, and sends the command to a
/// robot of its own. `Experiment.control_loop` creates it.
///
/// Targets of tasks with a streamed reference are set by `target`. A fault is raised as RobotFault by the step that finds it;
/// the steps after it return the commands of the stop, and at last none.
#[pyclass(frozen, module = "opspace")]
pub(crate) struct ControlLoop {
    experiment: Arc<Experiment>,
    stepping: Mutex<Stepping>,
}

/// Builds the loop of an experiment.
pub(crate) fn build(experiment: &Experiment) -> PyResult<Stepped> {
    let control = caught(|| experiment.control_loop())?.map_err(|error| of_file(&error, &[]))?;
    let targets = control.targets();
    Ok(Stepped::Loop { control: Box::new(control), targets })
}

impl ControlLoop {
    pub(crate) fn new(experiment: Arc<Experiment>) -> PyResult<Self> {
        let stepping = Mutex::new(Stepping::new(build(&experiment)?));
        Ok(Self { experiment, stepping })
    }

    fn lock(&self) -> MutexGuard<'_, Stepping> {
        self.stepping.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Computes a cycle of `stepping`; `before` is called with the filled sample.
pub(crate) fn step<'py>(
    py: Python<'py>,
    stepping: &mut Stepping,
    measured: &Measured<'_, 'py>,
    out: Option<&Bound<'py, PyAny>>,
    before: impl FnOnce(&mut Stepped),
) -> PyResult<Returned<'py>> {
    let out = out.map(|out| output(out, stepping.sample.q.len())).transpose()?;
    measured.copy_to(&mut stepping.sample)?;
    let Stepping { stepped, sample, .. } = stepping;
    before(stepped);
    let result = caught(|| returned(py, stepped.cycle(sample), out.as_ref()));
    // The exception of a task stands for the fault that it causes.
    let is_new = stepping.note_fault();
    let result = result??;
    match is_new.then_some(&stepping.fault) {
        Some(Some(fault)) => Err(fault.error(py)?),
        _ => Ok(result),
    }
}

#[pymethods]
impl ControlLoop {
    /// Computes a cycle. Arrays are in the order of `joints`; rad, rad/s and Nm, or m, m/s and N.
    ///
    /// time_s: time of the sample on the robot's clock, s; it increases. q: positions (n). dq: velocities (n), motor_torque: torques
    /// of the motors (n), joint_torque: measured torques (n), wrenches: readings of the force sensors (sensors × 6), if the robot
    /// measures them, as `measured` in robot.toml says. out: array (n) for the command's values, which is returned.
    ///
    /// Returns kind and values of the command: "position", "velocity" or "torque" with an array (n); "hold", in which the robot holds
    /// itself; or None if there is nothing to send.
    ///
    /// Raises RobotFault in the cycle of a fault, and OpspaceError for arguments of another shape.
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
        step(py, &mut self.lock(), &measured, out, |_| {})
    }

    /// Sets the target of a Cartesian task with a streamed reference, from the next cycle on. What is not given stays as it is.
    ///
    /// pose: position (3; m), or position and unit quaternion w, x, y, z (7). twist: linear (m/s) and angular velocity (rad/s) (6).
    /// acceleration (6). All three in world axes. wrench: force (N) and moment (Nm) that the environment exerts on the robot (6),
    /// in the axes of the task. gains: natural frequency (rad/s) and damping ratio, each a number or one per axis (6). modes: a
    /// dictionary of axes ("x" to "rz") and modes ("motion", "compliant", "force").
    ///
    /// Raises OpspaceError for a value that the task does not take; then nothing changes.
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
        self.lock().target(task, &TargetValues { pose, twist, acceleration, wrench, gains, modes })
    }

    /// Requests that the robot is held, from the next cycle on; or, with False, that control continues.
    #[pyo3(signature = (hold=true))]
    fn hold(&self, hold: bool) {
        self.lock().hold(hold);
    }

    /// Selects a task set by its number: 0 is the first one, each event of the task file prepares another.
    fn task_set(&self, number: u32) {
        self.lock().stepped.targets().choose_task_set(number);
    }

    /// Returns to the state before the first cycle. Targets are as configured.
    fn reset(&self, py: Python<'_>) -> PyResult<()> {
        let built = py.detach(|| build(&self.experiment))?;
        self.lock().restart(built);
        Ok(())
    }

    /// Phase: "rest", "control", "held", "resuming", "stopping" or "stopped".
    #[getter]
    fn phase(&self) -> &'static str {
        self.lock().phase()
    }

    /// Fault that stopped the robot, an exception; None if there was none.
    #[getter]
    fn fault(&self, py: Python<'_>) -> PyResult<Option<PyErr>> {
        let fault = self.lock().fault.clone();
        fault.map(|fault| fault.error(py)).transpose()
    }

    /// Names of the joints, in the order of all arrays (n).
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.lock().stepped.control().capabilities().joints.clone()
    }

    /// Period of a cycle, s.
    #[getter]
    fn period_s(&self) -> f64 {
        self.lock().stepped.control().capabilities().period_s
    }

    /// Signals of the last cycle, as in the channel `tick` of a log: a new dictionary of arrays by name.
    fn signals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, pyo3::types::PyDict>> {
        let mut stepping = self.lock();
        let control = stepping.stepped.control();
        signals(py, control.layout(), control.row())
    }
}

/// Returns the signals of a row by name.
pub(crate) fn signals<'py>(
    py: Python<'py>,
    layout: &opspace_backend::Layout,
    row: &[f64],
) -> PyResult<Bound<'py, pyo3::types::PyDict>> {
    let named = pyo3::types::PyDict::new(py);
    let mut at = 0;
    for signal in &layout.signals {
        let values = &row[at..at + signal.len()];
        named.set_item(&signal.name, PyArray1::from_slice(py, values))?;
        at += signal.len();
    }
    Ok(named)
}
