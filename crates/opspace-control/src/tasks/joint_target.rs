//! Streamed target of a joint-tracking task: a typed handle.

use crate::targets::{InputHandle, TargetError, Targets, TaskHandle};
use opspace_model::JointUnits;

/// An input: its name, and its units for all joints of a robot.
pub(crate) type Input = (&'static str, fn(&JointUnits) -> &[&'static str]);

/// The inputs, one value for each joint of the task: position, velocity, acceleration.
pub(crate) const JOINT_INPUTS: [Input; 3] =
    [("q", |units| &units.position), ("dq", |units| &units.velocity), ("ddq", |units| &units.acceleration)];

/// Streamed target of a joint-tracking task with a streamed reference.
///
/// Values are collected here and written together; those that were never set are as configured. Setters and
/// [`write`](Self::write) allocate nothing unless they fail.
#[derive(Clone, Debug)]
pub struct JointTarget {
    task: TaskHandle,
    inputs: [InputHandle; 3],
    values: [Vec<f64>; 3],
}

impl JointTarget {
    /// A handle for the task of that name.
    ///
    /// # Errors
    /// A task that has no such inputs.
    pub fn of(targets: &Targets, name: &str) -> Result<Self, TargetError> {
        let task = targets.task(name)?;
        let [q, dq, ddq] = JOINT_INPUTS.map(|(input, _)| targets.input(&task, input));
        let inputs = [q?, dq?, ddq?];
        let values = std::array::from_fn(|i| vec![f64::NAN; inputs[i].len()]);
        Ok(Self { task, inputs, values })
    }

    /// Sets the positions of the joints of the task, rad or m; forgets velocities and accelerations.
    ///
    /// # Errors
    /// Another number of values, or an infinite one. NaN lets a joint come to rest.
    pub fn position(&mut self, q: &[f64]) -> Result<&mut Self, TargetError> {
        self.set(0, q)?;
        self.values[1].fill(f64::NAN);
        self.values[2].fill(f64::NAN);
        Ok(self)
    }

    /// Sets the velocities, rad/s or m/s.
    ///
    /// # Errors
    /// Another number of values, or an infinite one.
    pub fn velocity(&mut self, dq: &[f64]) -> Result<&mut Self, TargetError> {
        self.set(1, dq)
    }

    /// Sets the accelerations, rad/s² or m/s².
    ///
    /// # Errors
    /// Another number of values, or an infinite one.
    pub fn acceleration(&mut self, ddq: &[f64]) -> Result<&mut Self, TargetError> {
        self.set(2, ddq)
    }

    fn set(&mut self, input: usize, values: &[f64]) -> Result<&mut Self, TargetError> {
        let expected = self.values[input].len();
        if values.len() != expected {
            return Err(TargetError::Length { expected, found: values.len() });
        }
        if let Some(&value) = values.iter().find(|value| value.is_infinite()) {
            return Err(TargetError::NotFinite { value });
        }
        self.values[input].copy_from_slice(values);
        Ok(self)
    }

    /// The task.
    #[must_use]
    pub fn task(&self) -> &TaskHandle {
        &self.task
    }

    /// The collected values, as [`Targets::write`] takes them.
    #[must_use]
    pub fn inputs(&self) -> [(&InputHandle, &[f64]); 3] {
        std::array::from_fn(|i| (&self.inputs[i], self.values[i].as_slice()))
    }

    /// Writes all collected values, stamped with `clock_s` (s, the robot's clock).
    ///
    /// # Errors
    /// As [`Targets::write`].
    pub fn write(&self, targets: &mut Targets, clock_s: f64) -> Result<(), TargetError> {
        targets.write(&self.task, clock_s, &self.inputs())
    }
}
