//! Class `ControlLoops`: many control loops of one experiment, stepped in one call.

use crate::arrays::{owned2, rows};
use crate::control_loop::build;
use crate::errors::{argument, caught};
use crate::stepping::{Stepping, TargetValues};
use numpy::{PyArray2, PyArrayMethods};
use opspace_backend::{Command, Sample};
use opspace_experiment::Experiment;
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use std::collections::BTreeMap;
use std::num::NonZero;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Control loops of one experiment for many robots, such as environments of a learning program. `Experiment.control_loops`
/// creates them. Each has targets and a state of its own.
#[pyclass(frozen, module = "opspace")]
pub(crate) struct ControlLoops {
    experiment: Arc<Experiment>,
    n: usize,
    loops: Mutex<Vec<Stepping>>,
}

/// Measurements of all robots, row by row; `None` for quantities that are not given.
struct Rows {
    time_s: Vec<f64>,
    q: Vec<f64>,
    dq: Option<Vec<f64>>,
    motor_torque: Option<Vec<f64>>,
    joint_torque: Option<Vec<f64>>,
    wrenches: Option<Vec<f64>>,
}

impl Rows {
    /// Copies the measurements of a robot to its sample.
    fn copy_to(&self, robot: usize, sample: &mut Sample) {
        fn copy(from: Option<&Vec<f64>>, robot: usize, to: Option<&mut [f64]>) {
            if let (Some(from), Some(to)) = (from, to) {
                let width = to.len();
                to.copy_from_slice(&from[robot * width..][..width]);
            }
        }
        sample.time_s = self.time_s[robot];
        copy(Some(&self.q), robot, Some(&mut sample.q));
        copy(self.dq.as_ref(), robot, sample.dq.as_deref_mut());
        copy(self.motor_torque.as_ref(), robot, sample.motor_torque.as_deref_mut());
        copy(self.joint_torque.as_ref(), robot, sample.joint_torque.as_deref_mut());
        copy(self.wrenches.as_ref(), robot, Some(sample.wrenches.as_flattened_mut()));
    }
}

/// Computes a cycle of loops; the first one is that of `first`. Rows without a command become NaN.
fn step_all(loops: &mut [Stepping], first: usize, measured: &Rows, n: usize, out: &mut [f64]) {
    for ((at, each), row) in loops.iter_mut().enumerate().zip(out.chunks_exact_mut(n)) {
        measured.copy_to(first + at, &mut each.sample);
        let Stepping { stepped, sample, .. } = each;
        match stepped.cycle(sample) {
            Some(Command::Torque(values) | Command::Position(values) | Command::Velocity(values)) => {
                row.copy_from_slice(values);
            }
            Some(Command::Hold) | None => row.fill(f64::NAN),
        }
        each.note_fault();
    }
}

impl ControlLoops {
    pub(crate) fn new(experiment: Arc<Experiment>, count: usize) -> PyResult<Self> {
        let loops: Vec<Stepping> =
            (0..count).map(|_| build(&experiment).map(Stepping::new)).collect::<PyResult<_>>()?;
        Ok(Self { n: experiment.robot().model.n(), experiment, loops: Mutex::new(loops) })
    }

    /// The loops. Python's lock is released while another thread steps them.
    fn lock(&self, py: Python<'_>) -> MutexGuard<'_, Vec<Stepping>> {
        self.loops.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }

    fn with<T>(
        &self,
        py: Python<'_>,
        robot: usize,
        body: impl FnOnce(&mut Stepping) -> PyResult<T>,
    ) -> PyResult<T> {
        let mut loops = self.lock(py);
        let count = loops.len();
        match loops.get_mut(robot) {
            Some(stepping) => body(stepping),
            None => Err(argument("robot", &format!("there are {count} loops, numbered from 0"))),
        }
    }
}

#[pymethods]
impl ControlLoops {
    /// Computes a cycle of each loop, without Python's lock.
    ///
    /// time_s: one time for all, or an array (N), s. q, dq, motor_torque, joint_torque: arrays (N × n), those that robot.toml
    /// declares; wrenches: (N × 6 sensors). out: array (N × n) that receives the commands. threads: threads that share the loops; it
    /// pays from some hundred loops on.
    ///
    /// Returns the values of the commands (N × n); a row is NaN where the robot holds itself, or where nothing is to be sent. A
    /// fault raises nothing: `faults` has it, and the row has the commands of the stop.
    ///
    /// Raises OpspaceError for arrays of another shape.
    #[pyo3(signature = (time_s, q, dq=None, motor_torque=None, joint_torque=None, wrenches=None, out=None, threads=NonZero::<usize>::MIN))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn step<'py>(
        &self,
        py: Python<'py>,
        time_s: &Bound<'py, PyAny>,
        q: &Bound<'py, PyAny>,
        dq: Option<&Bound<'py, PyAny>>,
        motor_torque: Option<&Bound<'py, PyAny>>,
        joint_torque: Option<&Bound<'py, PyAny>>,
        wrenches: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyArray2<f64>>>,
        threads: NonZero<usize>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let mut loops = self.lock(py);
        let (count, n) = (loops.len(), self.n);
        let declared = self.experiment.capabilities();
        let sized = |name: &str, value: &Bound<'py, PyAny>, width: usize| {
            let (numbers, given) = rows(name, value, width)?;
            if given == count {
                Ok(numbers)
            } else {
                Err(argument(name, &format!("expected {count} rows, got {given}")))
            }
        };
        let optional = |name: &str, value: Option<&Bound<'py, PyAny>>, is_measured: bool, width: usize| match (
            value,
            is_measured,
        ) {
            (Some(value), true) => sized(name, value, width).map(Some),
            (None, false) => Ok(None),
            (None, true) => Err(argument(name, "the robot declares it as measured, and it is missing")),
            (Some(_), false) => Err(argument(name, "the robot does not declare it as measured")),
        };
        let sensors = 6 * declared.force_sensors.len();
        let measured = Rows {
            time_s: match time_s.extract::<f64>() {
                Ok(time_s) => vec![time_s; count],
                Err(_) => {
                    let mut times = vec![0.0; count];
                    crate::arrays::vector("time_s", time_s, &mut times)?;
                    times
                }
            },
            q: sized("q", q, n)?,
            dq: optional("dq", dq, declared.measures_velocity, n)?,
            motor_torque: optional("motor_torque", motor_torque, declared.measures_motor_torque, n)?,
            joint_torque: optional("joint_torque", joint_torque, declared.measures_joint_torque, n)?,
            wrenches: optional("wrenches", wrenches, sensors > 0, sensors)?,
        };
        if let Some(out) = out {
            crate::arrays::check_out("out", out, [count, n])?;
        }
        let mut values = vec![0.0; count * n];
        let each = count.div_ceil(threads.get()).max(1);
        let loops: &mut [Stepping] = &mut loops;
        py.detach(|| {
            caught(|| match threads.get() {
                1 => step_all(loops, 0, &measured, n, &mut values),
                _ => thread::scope(|scope| {
                    let parts = loops.chunks_mut(each).zip(values.chunks_mut(each * n)).enumerate();
                    for (part, (loops, values)) in parts {
                        let measured = &measured;
                        scope.spawn(move || step_all(loops, part * each, measured, n, values));
                    }
                }),
            })
        })?;
        let Some(out) = out else {
            return owned2(py, values, count, n);
        };
        let mut target = out.try_readwrite().map_err(|error| argument("out", &error.to_string()))?;
        target.as_array_mut().iter_mut().zip(&values).for_each(|(to, from)| *to = *from);
        Ok(out.clone())
    }

    /// Sets the target of a task of one loop, as `ControlLoop.target` does.
    #[pyo3(signature = (robot, task, *, pose=None, twist=None, acceleration=None, wrench=None, gains=None, modes=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn target<'py>(
        &self,
        py: Python<'py>,
        robot: usize,
        task: &str,
        pose: Option<&Bound<'py, PyAny>>,
        twist: Option<&Bound<'py, PyAny>>,
        acceleration: Option<&Bound<'py, PyAny>>,
        wrench: Option<&Bound<'py, PyAny>>,
        gains: Option<&Bound<'py, PyAny>>,
        modes: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<()> {
        let values = TargetValues { pose, twist, acceleration, wrench, gains, modes };
        self.with(py, robot, |stepping| stepping.target(task, &values))
    }

    /// Returns one loop to the state before its first cycle.
    fn reset(&self, py: Python<'_>, robot: usize) -> PyResult<()> {
        let built = py.detach(|| build(&self.experiment))?;
        self.with(py, robot, |stepping| {
            stepping.restart(built);
            Ok(())
        })
    }

    /// Faults of the robots, exceptions by number; a robot without a fault has none.
    #[getter]
    fn faults(&self, py: Python<'_>) -> PyResult<BTreeMap<usize, PyErr>> {
        let faults = self.lock(py).iter().map(|stepping| stepping.fault.clone()).collect::<Vec<_>>();
        let faults = faults.into_iter().enumerate().filter_map(|(robot, fault)| Some((robot, fault?)));
        faults.map(|(robot, fault)| Ok((robot, fault.error(py)?))).collect()
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.lock(py).len()
    }
}
