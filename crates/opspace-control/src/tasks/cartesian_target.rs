//! Inputs of a Cartesian task's streamed target, and a typed handle for it.

use crate::axis_mode::AxisMode;
use crate::orientation;
use crate::references::streamed::given;
use crate::references::streamed_pose::{ACCELERATION, POSE, QUATERNION_TOLERANCE, TWIST};
use crate::targets::{AllowedInputs, InputHandle, TargetError, Targets, TaskHandle};
use crate::tasks::axes::AXIS_NAMES;
use opspace_backend::Signal;
use opspace_model::Placement;
use std::ops::Range;

/// Indices of the other inputs among all values.
const WRENCH: usize = 19;
const FREQUENCY: usize = 25;
const DAMPING_RATIO: usize = 31;
const MODES: usize = 37;
const WIDTH: usize = 43;

const POSE_ELEMENTS: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];

/// An input: its name, unit, elements and first index.
type Input = (&'static str, &'static str, &'static [&'static str], usize);

/// All inputs. The wrench is the target force that the environment should exert ON the robot on compliant and force axes.
/// Wrench, gains and modes are in the task axes.
const INPUTS: [Input; 7] = [
    ("pose", "m,1", &POSE_ELEMENTS, POSE),
    ("twist", "m/s,rad/s", &AXIS_NAMES, TWIST),
    ("acceleration", "m/s^2,rad/s^2", &AXIS_NAMES, ACCELERATION),
    ("wrench", "N,Nm", &AXIS_NAMES, WRENCH),
    ("frequency_rad_per_s", "rad/s", &AXIS_NAMES, FREQUENCY),
    ("damping_ratio", "1", &AXIS_NAMES, DAMPING_RATIO),
    ("modes", "1", &AXIS_NAMES, MODES),
];

/// Inputs of a Cartesian task that a program can change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CartesianInputs {
    /// The streamed reference, and the settings.
    All,
    /// Forces, gains and modes.
    Settings,
}

impl CartesianInputs {
    /// Index of the first of them among all values.
    fn first(self) -> usize {
        match self {
            Self::All => POSE,
            Self::Settings => WRENCH,
        }
    }

    /// Signals of the inputs.
    pub fn signals(self) -> Vec<Signal> {
        let inputs = INPUTS.iter().filter(|(.., first)| *first >= self.first());
        inputs.map(|(name, unit, elements, _)| Signal::new(*name, *unit, elements)).collect()
    }

    /// Reads the settings from a task's values.
    pub fn settings(self, values: &[f64]) -> [AxisSettings; 6] {
        let value = |at: usize| given::<1>(values, at - self.first()).map(|[value]| value);
        std::array::from_fn(|axis| AxisSettings {
            mode: value(MODES + axis).and_then(AxisMode::from_code),
            force: value(WRENCH + axis),
            frequency_rad_per_s: value(FREQUENCY + axis).filter(|&value| value > 0.0),
            damping_ratio: value(DAMPING_RATIO + axis).filter(|&value| value >= 0.0),
        })
    }
}

/// Streamed settings of one axis; `None` for the configured value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AxisSettings {
    pub mode: Option<AxisMode>,
    /// Target force, N or Nm.
    pub force: Option<f64>,
    pub frequency_rad_per_s: Option<f64>,
    pub damping_ratio: Option<f64>,
}

/// Target of a Cartesian or centre-of-mass task: reference and settings if its reference is streamed, the settings alone
/// if it is tunable.
///
/// Setters collect values, and [`write`](Self::write) writes them all at once; values that were never set are as
/// configured. Neither allocates unless it fails.
#[derive(Clone, Debug)]
pub struct CartesianTarget {
    task: TaskHandle,
    name: String,
    /// Handles of all inputs, of length 0 for those that the task lacks.
    inputs: [InputHandle; 7],
    allowed: AllowedInputs,
    values: [f64; WIDTH],
}

impl CartesianTarget {
    /// Creates a handle for the task of this name.
    ///
    /// # Errors
    /// An unknown task, or a task without these inputs.
    pub fn of(targets: &Targets, name: &str) -> Result<Self, TargetError> {
        let task = targets.task(name)?;
        let find = |(input, _, elements, first): Input| {
            let handle = match targets.input(&task, input) {
                Err(_) if first < WRENCH => return Ok(InputHandle::absent(&task)),
                handle => handle?,
            };
            let (expected, found) = (elements.len(), handle.len());
            if found == expected { Ok(handle) } else { Err(TargetError::Length { expected, found }) }
        };
        let [a, b, c, d, e, f, g] = INPUTS.map(find);
        Ok(Self {
            task,
            name: name.to_owned(),
            inputs: [a?, b?, c?, d?, e?, f?, g?],
            allowed: targets.allowed(&task),
            values: [f64::NAN; WIDTH],
        })
    }

    /// Sets position (m) and orientation (unit quaternion w, x, y, z), and clears twist and acceleration.
    ///
    /// # Errors
    /// A value that is not finite; a quaternion whose length is not 1 within [`QUATERNION_TOLERANCE`]; a reference that is
    /// not streamed.
    pub fn pose(&mut self, position: [f64; 3], quaternion: [f64; 4]) -> Result<&mut Self, TargetError> {
        self.check_streamed("pose")?;
        check_finite(&position)?;
        check_finite(&quaternion)?;
        let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (norm - 1.0).abs() > QUATERNION_TOLERANCE {
            return Err(TargetError::Quaternion { norm, tolerance: QUATERNION_TOLERANCE });
        }
        self.put(POSE, &position);
        self.put(POSE + 3, &quaternion.map(|x| x / norm));
        Ok(self.forget(TWIST..ACCELERATION + 6))
    }

    /// Sets the pose, and clears twist and acceleration.
    ///
    /// # Errors
    /// As [`pose`](Self::pose).
    pub fn placement(&mut self, placement: &Placement) -> Result<&mut Self, TargetError> {
        let q = orientation::quaternion(&placement.rotation);
        self.pose(placement.translation.into(), [q.w, q.i, q.j, q.k])
    }

    /// Sets only the position, m; the orientation of the reference does not change. Clears twist and acceleration.
    ///
    /// # Errors
    /// A value that is not finite; a reference that is not streamed.
    pub fn position(&mut self, position: [f64; 3]) -> Result<&mut Self, TargetError> {
        self.check_streamed("pose")?;
        check_finite(&position)?;
        self.put(POSE, &position);
        Ok(self.forget(POSE + 3..ACCELERATION + 6))
    }

    /// Sets linear (m/s) and angular velocity (rad/s), world axes. Without a pose, the reference continues from its
    /// current pose.
    ///
    /// # Errors
    /// A value that is not finite; a reference that is not streamed.
    pub fn twist(&mut self, twist: [f64; 6]) -> Result<&mut Self, TargetError> {
        self.check_streamed("twist")?;
        check_finite(&twist)?;
        Ok(self.put(TWIST, &twist))
    }

    /// Sets linear (m/s²) and angular acceleration (rad/s²), world axes.
    ///
    /// # Errors
    /// A value that is not finite; a reference that is not streamed.
    pub fn acceleration(&mut self, acceleration: [f64; 6]) -> Result<&mut Self, TargetError> {
        self.check_streamed("acceleration")?;
        check_finite(&acceleration)?;
        Ok(self.put(ACCELERATION, &acceleration))
    }

    /// Sets the force (N) and moment (Nm) that the environment should exert ON the robot on compliant and force axes,
    /// in task axes; NaN for the configured value.
    ///
    /// # Errors
    /// An infinite value.
    pub fn wrench(&mut self, wrench: [f64; 6]) -> Result<&mut Self, TargetError> {
        if let Some(&value) = wrench.iter().find(|value| value.is_infinite()) {
            return Err(TargetError::NotFinite { value });
        }
        Ok(self.put(WRENCH, &wrench))
    }

    /// Sets natural frequency (rad/s) and damping ratio of motion axes; NaN for the configured value.
    ///
    /// # Errors
    /// A frequency that is not positive, a negative ratio, a task that is not configured with `gains`.
    pub fn gains(
        &mut self,
        frequency_rad_per_s: [f64; 6],
        damping_ratio: [f64; 6],
    ) -> Result<&mut Self, TargetError> {
        if !self.allowed.gains {
            return Err(TargetError::NoGains { task: self.name.clone() });
        }
        check_gains("frequency_rad_per_s", "above 0", &frequency_rad_per_s, |value| value > 0.0)?;
        check_gains("damping_ratio", "0 or above", &damping_ratio, |value| value >= 0.0)?;
        self.put(FREQUENCY, &frequency_rad_per_s);
        Ok(self.put(DAMPING_RATIO, &damping_ratio))
    }

    /// Sets the mode of each axis (in the order of [`AXIS_NAMES`]); `None` for the configured mode.
    ///
    /// # Errors
    /// The mode `free`, an axis that is not in the task, or a mode for which the axis is not configured. Then no mode
    /// changes.
    pub fn modes(&mut self, modes: [Option<AxisMode>; 6]) -> Result<&mut Self, TargetError> {
        let mut codes = [f64::NAN; 6];
        for (axis, mode) in modes.into_iter().enumerate() {
            let Some(mode) = mode else { continue };
            self.check_mode(axis, mode)?;
            codes[axis] = mode.code();
        }
        Ok(self.put(MODES, &codes))
    }

    /// Checks that the task has an input of its reference.
    fn check_streamed(&self, name: &'static str) -> Result<(), TargetError> {
        let at = INPUTS.iter().position(|(input, ..)| *input == name);
        if at.is_some_and(|at| self.inputs[at].len() > 0) {
            return Ok(());
        }
        Err(TargetError::NotStreamed { task: self.name.clone(), name })
    }

    fn check_mode(&self, axis: usize, mode: AxisMode) -> Result<(), TargetError> {
        let allowed = &self.allowed.modes;
        if mode == AxisMode::Free || !allowed[axis].contains(&true) {
            let known = (0..6).filter(|&axis| allowed[axis].contains(&true)).map(|axis| AXIS_NAMES[axis]);
            let (task, axis) = (self.name.clone(), AXIS_NAMES[axis]);
            return Err(TargetError::Axis { task, axis, known: known.collect() });
        }
        if self.allowed.admits(axis, mode) {
            return Ok(());
        }
        let possible = AxisMode::IN_TASK.into_iter().filter(|mode| self.allowed.admits(axis, *mode));
        let known = possible.map(AxisMode::name).collect();
        Err(TargetError::Mode { task: self.name.clone(), axis: AXIS_NAMES[axis], mode: mode.name(), known })
    }

    /// Resets all values to "as configured".
    pub fn clear(&mut self) -> &mut Self {
        self.forget(0..WIDTH)
    }

    /// Handle of the task.
    #[must_use]
    pub fn task(&self) -> &TaskHandle {
        &self.task
    }

    /// Collected values in the form that [`Targets::write`] takes; no values for inputs that the task lacks.
    #[must_use]
    pub fn inputs(&self) -> [(&InputHandle, &[f64]); 7] {
        std::array::from_fn(|i| {
            let (handle, (.., first)) = (&self.inputs[i], INPUTS[i]);
            (handle, &self.values[first..first + handle.len()])
        })
    }

    /// Writes all collected values with the time stamp `clock_s`, s on the robot's clock.
    ///
    /// # Errors
    /// As [`Targets::write`].
    pub fn write(&self, targets: &mut Targets, clock_s: f64) -> Result<(), TargetError> {
        targets.write(&self.task, clock_s, &self.inputs())
    }

    fn put(&mut self, at: usize, values: &[f64]) -> &mut Self {
        self.values[at..at + values.len()].copy_from_slice(values);
        self
    }

    fn forget(&mut self, range: Range<usize>) -> &mut Self {
        self.values[range].fill(f64::NAN);
        self
    }
}

fn check_finite(values: &[f64]) -> Result<(), TargetError> {
    let wrong = values.iter().find(|value| !value.is_finite());
    wrong.map_or(Ok(()), |&value| Err(TargetError::NotFinite { value }))
}

fn check_gains(
    input: &'static str,
    range: &'static str,
    values: &[f64; 6],
    good: impl Fn(f64) -> bool,
) -> Result<(), TargetError> {
    let good = |value: f64| value.is_nan() || (value.is_finite() && good(value));
    match values.iter().position(|&value| !good(value)) {
        Some(axis) => Err(TargetError::Gain { input, axis: AXIS_NAMES[axis], range, value: values[axis] }),
        None => Ok(()),
    }
}
