//! Measurements of a cycle as Python passes them, and the command that a cycle returns.

use crate::arrays::vector;
use crate::errors::argument;
use numpy::{PyArray1, PyArrayMethods, PyUntypedArrayMethods, ToPyArray};
use opspace_backend::{Command, Sample};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Measurements of a cycle, arguments of `step`.
pub(crate) struct Measured<'a, 'py> {
    pub time_s: f64,
    pub q: &'a Bound<'py, PyAny>,
    pub dq: Option<&'a Bound<'py, PyAny>>,
    pub motor_torque: Option<&'a Bound<'py, PyAny>>,
    pub joint_torque: Option<&'a Bound<'py, PyAny>>,
    pub wrenches: Option<&'a Bound<'py, PyAny>>,
}

impl Measured<'_, '_> {
    /// Copies the measurements to a sample, which has the quantities that the robot declares.
    ///
    /// # Errors
    /// A quantity that is declared and missing, or given and not declared; numbers of another shape.
    pub(crate) fn copy_to(&self, sample: &mut Sample) -> PyResult<()> {
        sample.time_s = self.time_s;
        vector("q", self.q, &mut sample.q)?;
        optional("dq", self.dq, sample.dq.as_deref_mut())?;
        optional("motor_torque", self.motor_torque, sample.motor_torque.as_deref_mut())?;
        optional("joint_torque", self.joint_torque, sample.joint_torque.as_deref_mut())?;
        let sensors = sample.wrenches.as_flattened_mut();
        optional("wrenches", self.wrenches, Some(sensors).filter(|sensors| !sensors.is_empty()))
    }
}

/// Copies a quantity that a robot may measure.
fn optional(name: &str, given: Option<&Bound<'_, PyAny>>, declared: Option<&mut [f64]>) -> PyResult<()> {
    match (given, declared) {
        (Some(value), Some(out)) => {
            let value = if name == "wrenches" {
                &value.call_method1("reshape", (-1,)).unwrap_or(value.clone())
            } else {
                value
            };
            vector(name, value, out)
        }
        (None, None) => Ok(()),
        (None, Some(_)) => Err(argument(name, "the robot declares it as measured, and it is missing")),
        (Some(_), None) => {
            Err(argument(name, "the robot does not declare it as measured; see `measured` in robot.toml"))
        }
    }
}

/// Returns a sample as arguments of `step`.
pub(crate) fn arguments<'py>(py: Python<'py>, sample: &Sample) -> PyResult<Bound<'py, PyDict>> {
    let arguments = PyDict::new(py);
    arguments.set_item("time_s", sample.time_s)?;
    arguments.set_item("q", sample.q.to_pyarray(py))?;
    let optional =
        [("dq", &sample.dq), ("motor_torque", &sample.motor_torque), ("joint_torque", &sample.joint_torque)];
    for (name, values) in optional {
        if let Some(values) = values {
            arguments.set_item(name, values.to_pyarray(py))?;
        }
    }
    if !sample.wrenches.is_empty() {
        let rows = crate::arrays::copied2(py, sample.wrenches.as_flattened(), sample.wrenches.len(), 6)?;
        arguments.set_item("wrenches", rows)?;
    }
    Ok(arguments)
}

/// Command of a cycle: its kind, and the array of its values (n).
pub(crate) type Returned<'py> = (Option<&'static str>, Option<Bound<'py, PyArray1<f64>>>);

/// Returns a command, with its values in `out` if it is given.
pub(crate) fn returned<'py>(
    py: Python<'py>,
    command: Option<Command<'_>>,
    out: Option<&Bound<'py, PyArray1<f64>>>,
) -> PyResult<Returned<'py>> {
    let (kind, values) = match command {
        None => return Ok((None, None)),
        Some(Command::Hold) => return Ok((Some("hold"), None)),
        Some(Command::Torque(values)) => ("torque", values),
        Some(Command::Position(values)) => ("position", values),
        Some(Command::Velocity(values)) => ("velocity", values),
    };
    let Some(out) = out else {
        return Ok((Some(kind), Some(values.to_pyarray(py))));
    };
    let mut target = out.try_readwrite().map_err(|error| argument("out", &error.to_string()))?;
    let mut target = target.as_array_mut();
    target.iter_mut().zip(values).for_each(|(to, from)| *to = *from);
    Ok((Some(kind), Some(out.clone())))
}

/// Returns the array that receives a command.
///
/// # Errors
/// Another type, or another length.
pub(crate) fn output<'py>(out: &Bound<'py, PyAny>, n: usize) -> PyResult<Bound<'py, PyArray1<f64>>> {
    match out.cast::<PyArray1<f64>>() {
        Ok(array) if array.len() == n => Ok(array.clone()),
        Ok(array) => Err(argument("out", &format!("expected {n} values, got {}", array.len()))),
        Err(_) => {
            Err(argument("out", &format!("expected an array of {n} values of float64, which is written to")))
        }
    }
}
