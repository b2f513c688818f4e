//! Common parts of `ControlLoop` and `Run`: a cycle, targets by the names of tasks, and the state of the loop.

use crate::arrays::vector;
use crate::errors::{FaultText, argument, refused};
use opspace_backend::{Command, Sample};
use opspace_control::{AXIS_NAMES, AxisMode, CartesianTarget, TargetError, Targets};
use opspace_experiment::run::owned_run::OwnedRun;
use opspace_loop::{ControlLoop, Phase};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};

/// Receiver of a log: memory or a file.
pub(crate) enum LogSink {
    Memory(Vec<u8>),
    File(BufWriter<File>),
}

impl Write for LogSink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Memory(memory) => memory.write(bytes),
            Self::File(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Memory(memory) => memory.flush(),
            Self::File(file) => file.flush(),
        }
    }
}

/// Control loop that Python steps, with or without a log.
pub(crate) enum Stepped {
    Loop { control: Box<ControlLoop>, targets: Targets },
    Run(Box<OwnedRun<LogSink>>),
}

impl Stepped {
    pub(crate) fn control(&mut self) -> &ControlLoop {
        match self {
            Self::Loop { control, .. } => control,
            Self::Run(run) => run.run().control(),
        }
    }

    pub(crate) fn targets(&mut self) -> &mut Targets {
        match self {
            Self::Loop { targets, .. } => targets,
            Self::Run(run) => run.run().targets(),
        }
    }

    /// Computes a cycle and returns the command for the robot.
    pub(crate) fn cycle(&mut self, sample: &Sample) -> Option<Command<'_>> {
        match self {
            Self::Loop { control, targets } => control.step(sample, targets).command,
            Self::Run(run) => run.run().cycle(sample),
        }
    }
}

/// Stepped loop with its sample and the handles of its tasks.
pub(crate) struct Stepping {
    pub stepped: Stepped,
    pub sample: Sample,
    /// Fault that stopped the robot, with the time at which it was found.
    pub fault: Option<FaultText>,
    handles: BTreeMap<String, CartesianTarget>,
}

/// Values of a target, arguments of `target`.
pub(crate) struct TargetValues<'a, 'py> {
    pub pose: Option<&'a Bound<'py, PyAny>>,
    pub twist: Option<&'a Bound<'py, PyAny>>,
    pub acceleration: Option<&'a Bound<'py, PyAny>>,
    pub wrench: Option<&'a Bound<'py, PyAny>>,
    pub gains: Option<&'a Bound<'py, PyAny>>,
    pub modes: Option<&'a Bound<'py, PyAny>>,
}

impl Stepping {
    pub(crate) fn new(mut stepped: Stepped) -> Self {
        let sample = Sample::new(stepped.control().capabilities());
        Self { stepped, sample, fault: None, handles: BTreeMap::new() }
    }

    /// Keeps the fault that a cycle found. Returns true if it is the first one.
    pub(crate) fn note_fault(&mut self) -> bool {
        let control = self.stepped.control();
        let found = control.result().fault.filter(|_| self.fault.is_none());
        let found = found.map(|fault| FaultText::new(fault, control.measurement().time_s, control.model()));
        let is_new = found.is_some();
        self.fault = found.or(self.fault.take());
        is_new
    }

    /// Replaces the loop by one before its first cycle.
    pub(crate) fn restart(&mut self, stepped: Stepped) {
        *self = Self::new(stepped);
    }

    /// Names of the axes of `modes`, and of the modes.
    fn modes(modes: &BTreeMap<String, String>) -> PyResult<[Option<AxisMode>; 6]> {
        let mut parsed = [None; 6];
        for (axis, mode) in modes {
            let place = AXIS_NAMES.iter().position(|name| name == axis);
            let place = place.ok_or_else(|| {
                argument("modes", &format!("no axis '{axis}'; the axes are: {}", AXIS_NAMES.join(", ")))
            })?;
            let known = AxisMode::IN_TASK.into_iter().find(|known| known.name() == mode);
            let names = AxisMode::IN_TASK.map(AxisMode::name).join(", ");
            parsed[place] =
                Some(known.ok_or_else(|| {
                    argument("modes", &format!("no mode '{mode}'; the modes are: {names}"))
                })?);
        }
        Ok(parsed)
    }

    /// Sets the target of a Cartesian task from the next cycle on.
    pub(crate) fn target(&mut self, task: &str, values: &TargetValues<'_, '_>) -> PyResult<()> {
        let Self { stepped, handles, .. } = self;
        let clock_s = stepped.control().clock_s();
        let targets = stepped.targets();
        if !handles.contains_key(task) {
            let handle = CartesianTarget::of(targets, task).map_err(|error| of_target(&error))?;
            handles.insert(task.to_owned(), handle);
        }
        let Some(handle) = handles.get_mut(task) else {
            return Ok(());
        };
        // A mistake changes nothing.
        let mut new = handle.clone();
        if let Some(pose) = values.pose {
            match pose.len().unwrap_or(0) {
                3 => new.position(finite("pose", pose)?).map_err(|error| of_target(&error))?,
                _ => {
                    let [x, y, z, w, i, j, k] = finite("pose", pose)?;
                    new.pose([x, y, z], [w, i, j, k]).map_err(|error| of_target(&error))?
                }
            };
        }
        if let Some(twist) = values.twist {
            new.twist(finite("twist", twist)?).map_err(|error| of_target(&error))?;
        }
        if let Some(acceleration) = values.acceleration {
            new.acceleration(finite("acceleration", acceleration)?).map_err(|error| of_target(&error))?;
        }
        if let Some(wrench) = values.wrench {
            new.wrench(numbers("wrench", wrench)?).map_err(|error| of_target(&error))?;
        }
        if let Some(gains) = values.gains {
            let pair = gains.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>();
            let (frequency, ratio) =
                pair.map_err(|_| argument("gains", "expected a pair: frequency_rad_per_s, damping_ratio"))?;
            let (frequency, ratio) = (of_axes("gains", &frequency)?, of_axes("gains", &ratio)?);
            new.gains(frequency, ratio).map_err(|error| of_target(&error))?;
        }
        if let Some(modes) = values.modes {
            let modes = modes.extract().map_err(|_| {
                argument("modes", "expected a dictionary of axes and modes, such as {\"x\": \"compliant\"}")
            })?;
            new.modes(Self::modes(&modes)?).map_err(|error| of_target(&error))?;
        }
        // Before the first cycle there is no clock yet.
        let clock_s = if clock_s.is_finite() { clock_s } else { 0.0 };
        new.write(targets, clock_s).map_err(|error| of_target(&error))?;
        *handle = new;
        Ok(())
    }

    /// Requests a hold, or its end.
    pub(crate) fn hold(&mut self, hold: bool) {
        self.stepped.targets().hold(hold);
    }

    /// Phase of the loop as a word.
    pub(crate) fn phase(&mut self) -> &'static str {
        match self.stepped.control().result().phase {
            Phase::Rest => "rest",
            Phase::Control => "control",
            Phase::Stopping => "stopping",
            Phase::Stopped => "stopped",
            Phase::Held => "held",
            Phase::Resuming => "resuming",
        }
    }
}

/// Finite numbers of an argument with a fixed length.
pub(crate) fn finite<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; N]> {
    let numbers = numbers(name, value)?;
    match numbers.iter().find(|number: &&f64| !number.is_finite()) {
        Some(number) => Err(argument(name, &format!("expected finite numbers, got {number}"))),
        None => Ok(numbers),
    }
}

/// Numbers of an argument with a fixed length.
fn numbers<const N: usize>(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; N]> {
    let mut numbers = [0.0; N];
    vector(name, value, &mut numbers)?;
    Ok(numbers)
}

/// One number for all axes, or one for each.
fn of_axes(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 6]> {
    match value.extract::<f64>() {
        Ok(number) => Ok([number; 6]),
        Err(_) => numbers(name, value),
    }
}

/// Error about a target.
fn of_target(error: &TargetError) -> PyErr {
    if let TargetError::Task { name, known } = error
        && known.is_empty()
    {
        let help = "give a Cartesian task `reference = { streamed = {} }`";
        return refused(format!("task '{name}' takes no targets, nor does any other task"), Some(help));
    }
    let help = match error {
        TargetError::Task { .. } => {
            Some("give the task `reference = { streamed = { .. } }`, which makes its inputs")
        }
        _ => None,
    };
    refused(error.to_string(), help)
}
