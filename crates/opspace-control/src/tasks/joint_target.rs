//! Typed handle for the streamed target of a joint-tracking task.

use crate::targets::{InputHandle, TargetError, Targets, TaskHandle};
use opspace_model::JointUnits;

/// An input: its name and its units per joint.
pub(crate) type Input = (&'static str, fn(&JointUnits) -> &[&'static str]);

/// Inputs with one value per joint of the task: position, velocity, acceleration.
pub(crate) const JOINT_INPUTS: [Input; 3] =
    [("q", |units| &units.position), ("dq", |units| &units.velocity), ("ddq", |units| &units.acceleration)];

/// Streamed target of a joint-tracking task with a streamed reference.
///
/// Setters collect values, and [`write`](Self::write) writes them all at once; values that were never set are as
/// configured. Neither allocates unless it fails.
#[derive(Clone, Debug)]
pub struct JointTarget {
    task: TaskHandle,
    inputs: [InputHandle; 3],
    values: [Vec<f64>; 3],
}

impl JointTarget {
    /// Creates a handle for the task of this name.
    ///
    /// # Errors
    /// An unknown task, or a task without these inputs.
    pub fn of(targets: &Targets, name: &str) -> Result<Self, TargetError> {
        let task = targets.task(name)?;
        let [q, dq, ddq] = JOINT_INPUTS.map(|(input, _)| targets.input(&task, input));
        let inputs = [q?, dq?, ddq?];
        let values = std::array::from_fn(|i| vec![f64::NAN; inputs[i].len()]);
        Ok(Self { task, inputs, values })
    }

    /// Sets the positions of the task's joints, rad or m, and clears velocities and accelerations. NaN lets a joint
    /// come to rest.
    ///
    /// # Errors
    /// A wrong number of values, or an infinite value.
    pub fn position(&mut self, q: &[f64]) -> Result<&mut Self, TargetError> {
        self.set(0, q)?;
        self.values[1].fill(f64::NAN);
        self.values[2].fill(f64::NAN);
        Ok(self)
    }

    /// Sets the velocities, rad/s or m/s.
    ///
    /// # Errors
    /// A wrong number of values, or an infinite value.
    pub fn velocity(&mut self, dq: &[f64]) -> Result<&mut Self, TargetError> {
        self.set(1, dq)
    }

    /// Sets the accelerations, rad/s² or m/s².
    ///
    /// # Errors
    /// A wrong number of values, or an infinite value.
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

    /// Handle of the task.
    #[must_use]
    pub fn task(&self) -> &TaskHandle {
        &self.task
    }

    /// Collected values in the form that [`Targets::write`] takes.
    #[must_use]
    pub fn inputs(&self) -> [(&InputHandle, &[f64]); 3] {
        std::array::from_fn(|i| (&self.inputs[i], self.values[i].as_slice()))
    }

    /// Writes all collected values with the time stamp `clock_s`, s on the robot's clock.
    ///
    /// # Errors
    /// As [`Targets::write`].
    pub fn write(&self, targets: &mut Targets, clock_s: f64) -> Result<(), TargetError> {
        targets.write(&self.task, clock_s, &self.inputs())
    }
}
