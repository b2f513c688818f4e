//! Class `Simulation`: the simulated robot of an experiment, stepped by Python.

use crate::errors::{argument, caught, of_file, refused};
use crate::measured::arguments;
use crate::stepping::finite;
use nalgebra::Vector3;
use numpy::{PyArray1, ToPyArray};
use opspace_backend::{Backend, Command, Sample};
use opspace_experiment::Experiment;
use opspace_model::{Force, Model};
use opspace_sim::{ExternalForceHandle, Pull, SimulatedArm};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Simulated robot with the sample of its last cycle.
pub(crate) struct Arm {
    pub arm: SimulatedArm,
    pub sample: Sample,
}

/// Simulated robot of an experiment: servos, gears, friction and contacts as robot.toml and task file state.
///
/// In a cycle: `read`, the step of a control loop, `write`. Reading advances the simulation to the next sample.
///
///     command = loop.step(**simulation.read())
///     simulation.write(*command)
#[pyclass(frozen, module = "opspace")]
pub(crate) struct Simulation {
    arm: Arc<Mutex<Arm>>,
    model: Model,
    force: Option<ExternalForceHandle>,
}

impl Simulation {
    pub(crate) fn new(experiment: &Experiment, start: Option<Vec<f64>>) -> PyResult<Self> {
        let build = || {
            let mut config = experiment.arm_config()?;
            config.external_forces = true;
            if let Some(start) = start {
                config.start = start;
            }
            experiment.simulated_arm_of(config)
        };
        let arm = caught(build)?.map_err(|error| of_file(&error, &[]))?;
        let sample = Sample::new(arm.capabilities());
        let force = arm.external_force();
        let model = experiment.robot().model.clone();
        Ok(Self { arm: Arc::new(Mutex::new(Arm { arm, sample })), model, force })
    }

    pub(crate) fn shared(&self) -> Arc<Mutex<Arm>> {
        Arc::clone(&self.arm)
    }

    fn lock(&self) -> MutexGuard<'_, Arm> {
        lock(&self.arm)
    }

    fn apply(&self, frame: &str, pull: Pull) -> PyResult<()> {
        let frame = self.model.frame_id(frame).map_err(|error| argument("frame", &error.to_string()))?;
        if let Some(force) = &self.force {
            force.apply(frame, pull);
        }
        Ok(())
    }
}

pub(crate) fn lock(arm: &Mutex<Arm>) -> MutexGuard<'_, Arm> {
    arm.lock().unwrap_or_else(PoisonError::into_inner)
}

#[pymethods]
impl Simulation {
    /// Advances to the next cycle and returns its measurements, as arguments of `ControlLoop.step`.
    ///
    /// Raises OpspaceError for a fault of the simulated robot, such as an over-current or a lost bus.
    fn read<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mut arm = self.lock();
        let Arm { arm: robot, sample } = &mut *arm;
        caught(|| robot.read(sample))?.map_err(|fault| refused(fault.to_string(), None))?;
        arguments(py, sample)
    }

    /// Sends a command to the drives: kind and values as `ControlLoop.step` returns them. None sends nothing.
    ///
    /// Raises OpspaceError for a command that the robot does not accept.
    #[pyo3(signature = (kind, values=None))]
    fn write(&self, kind: Option<&str>, values: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mut arm = self.lock();
        let mut numbers = vec![0.0; arm.sample.q.len()];
        if let Some(values) = values {
            crate::arrays::vector("values", values, &mut numbers)?;
        }
        let command = match (kind, values) {
            (None, _) => return Ok(()),
            (Some("hold"), _) => Command::Hold,
            (Some("torque"), Some(_)) => Command::Torque(&numbers),
            (Some("position"), Some(_)) => Command::Position(&numbers),
            (Some("velocity"), Some(_)) => Command::Velocity(&numbers),
            (Some("torque" | "position" | "velocity"), None) => {
                return Err(argument("values", "the command has none"));
            }
            (Some(other), _) => {
                return Err(argument(
                    "kind",
                    &format!("expected 'position', 'velocity', 'torque' or 'hold', got '{other}'"),
                ));
            }
        };
        caught(|| arm.arm.write(command))?.map_err(|fault| refused(fault.to_string(), None))
    }

    /// Enters the safe state: the robot holds itself.
    fn stop(&self) {
        self.lock().arm.stop();
    }

    /// Applies a force (N) and a moment (Nm) to the origin of a frame, world axes, from the next cycle on until `release`.
    #[pyo3(signature = (frame, force, moment=None))]
    fn push(&self, frame: &str, force: &Bound<'_, PyAny>, moment: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let moment = moment.map_or(Ok([0.0; 3]), |moment| finite("moment", moment))?;
        let force = finite::<3>("force", force)?;
        self.apply(frame, Pull::Wrench(Force { linear: force.into(), angular: moment.into() }))
    }

    /// Pulls the origin of a frame to a point (m, world axes) by a spring (N/m) and a damper (Ns/m), until `release`.
    #[pyo3(signature = (frame, to, stiffness_n_per_m, damping_ns_per_m=0.0))]
    fn pull(
        &self,
        frame: &str,
        to: &Bound<'_, PyAny>,
        stiffness_n_per_m: f64,
        damping_ns_per_m: f64,
    ) -> PyResult<()> {
        let to = finite::<3>("to", to)?;
        self.apply(frame, Pull::Spring { target_m: Vector3::from(to), stiffness_n_per_m, damping_ns_per_m })
    }

    /// Removes the force of `push` or `pull` from the next cycle on.
    fn release(&self) {
        if let Some(force) = &self.force {
            force.release();
        }
    }

    /// True positions of the joints, rad or m (n).
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.lock().arm.true_q().as_slice().to_pyarray(py)
    }

    /// True velocities of the joints, rad/s or m/s (n).
    #[getter]
    fn dq<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.lock().arm.true_dq().as_slice().to_pyarray(py)
    }
}
