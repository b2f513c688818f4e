//! Robot that is written in Python: an object with `read`, `write` and `stop`.

use crate::errors::argument;
use crate::measured::Measured;
use numpy::ToPyArray;
use opspace_backend::{Backend, Capabilities, Command, DeviceFault, Sample};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyMapping;

/// Code of the fault of a robot whose method raised an exception.
const RAISED: u32 = 1;

/// Backend whose methods are those of a Python object. The first exception is kept, with its traceback.
pub(crate) struct PythonRobot {
    robot: Py<PyAny>,
    capabilities: Capabilities,
    raised: Option<PyErr>,
}

impl PythonRobot {
    /// Creates the backend of an object.
    ///
    /// # Errors
    /// An object without one of the methods.
    pub(crate) fn new(robot: &Bound<'_, PyAny>, capabilities: Capabilities) -> PyResult<Self> {
        for method in ["read", "write", "stop"] {
            if !robot.getattr(method).is_ok_and(|method| method.is_callable()) {
                return Err(argument("robot", &format!("it has no method `{method}`")));
            }
        }
        Ok(Self { robot: robot.clone().unbind(), capabilities, raised: None })
    }

    /// Exception of a method, if one was raised.
    pub(crate) fn into_raised(self) -> Option<PyErr> {
        self.raised
    }

    fn failed(&mut self, method: &str, error: PyErr) -> DeviceFault {
        let fault = DeviceFault::new(RAISED, format!("`{method}` of the Python robot raised {error}"));
        self.raised.get_or_insert(error);
        fault
    }
}

/// Reads a mapping with the arguments of `ControlLoop.step`.
fn fill(read: &Bound<'_, PyAny>, sample: &mut Sample) -> PyResult<()> {
    let wrong = || {
        PyTypeError::new_err(
            "`read` returns a dictionary with `time_s`, `q` and the other arguments of `step`",
        )
    };
    let read = read.cast::<PyMapping>().map_err(|_| wrong())?;
    let item = |name: &str| read.get_item(name).ok().filter(|value| !value.is_none());
    let time_s = item("time_s").ok_or_else(wrong)?.extract()?;
    let q = item("q").ok_or_else(wrong)?;
    let (dq, motor_torque, joint_torque, wrenches) =
        (item("dq"), item("motor_torque"), item("joint_torque"), item("wrenches"));
    let measured = Measured {
        time_s,
        q: &q,
        dq: dq.as_ref(),
        motor_torque: motor_torque.as_ref(),
        joint_torque: joint_torque.as_ref(),
        wrenches: wrenches.as_ref(),
    };
    measured.copy_to(sample)
}

impl Backend for PythonRobot {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        let read = Python::attach(|py| fill(&self.robot.bind(py).call_method0("read")?, sample));
        read.map_err(|error| self.failed("read", error))
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        let (kind, values) = match command {
            Command::Torque(values) => ("torque", Some(values)),
            Command::Position(values) => ("position", Some(values)),
            Command::Velocity(values) => ("velocity", Some(values)),
            _ => ("hold", None),
        };
        let written = Python::attach(|py| {
            let values = values.map(|values| values.to_pyarray(py));
            self.robot.bind(py).call_method1("write", (kind, values)).map(|_| ())
        });
        written.map_err(|error| self.failed("write", error))
    }

    fn stop(&mut self) {
        let stopped = Python::attach(|py| self.robot.bind(py).call_method0("stop").map(|_| ()));
        if let Err(error) = stopped {
            self.raised.get_or_insert(error);
        }
    }
}
