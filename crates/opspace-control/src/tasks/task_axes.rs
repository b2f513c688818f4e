//! Rows of a Cartesian task: the axes that belong to it, scaled to a common unit.

use crate::tasks::controlled_frame::ControlledFrame;
use nalgebra::{Matrix3, Matrix6xX, Vector3, Vector6};
use opspace_model::Motion;

/// Task axes of a motion. Rotations are multiplied by a characteristic length, so that eigenvalues over linear and
/// angular rows do not depend on the unit of length.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskAxes {
    /// The controlled frame.
    pub controlled: ControlledFrame,
    /// Task axes in the coordinates of the controlled frame, one per column.
    pub rotation: Matrix3<f64>,
    /// Factors of the six axes: 1, or the characteristic length (m) for rotations.
    pub scale: [f64; 6],
    rows: [usize; 6],
    count: usize,
}

impl TaskAxes {
    /// Creates the axes of `controlled`; `in_task` marks those in the task, in the order of
    /// [`AXIS_NAMES`](crate::tasks::axes::AXIS_NAMES). `length_m` is the characteristic length, m.
    #[must_use]
    pub fn new(
        controlled: ControlledFrame,
        rotation: Matrix3<f64>,
        in_task: [bool; 6],
        length_m: f64,
    ) -> Self {
        let mut rows = [0; 6];
        let mut count = 0;
        for (axis, _) in in_task.iter().enumerate().filter(|(_, used)| **used) {
            rows[count] = axis;
            count += 1;
        }
        let scale = [1.0, 1.0, 1.0, length_m, length_m, length_m];
        Self { controlled, rotation, scale, rows, count }
    }

    /// Returns the same axes in other directions.
    #[must_use]
    pub fn with_rotation(&self, rotation: Matrix3<f64>) -> Self {
        Self { rotation, ..self.clone() }
    }

    /// Number of axes in the task.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.count
    }

    /// Indices in [`AXIS_NAMES`](crate::tasks::axes::AXIS_NAMES) of the axes in the task, in the order of the rows.
    #[must_use]
    pub fn axes(&self) -> &[usize] {
        &self.rows[..self.count]
    }

    /// Computes the scaled rows of the task from the controlled frame's Jacobian `world` (6 × n), and writes them to
    /// the first rows of `selected` (6 × n).
    ///
    /// # Panics
    /// If the two matrices differ in size.
    pub fn select(&self, world: &Matrix6xX<f64>, selected: &mut Matrix6xX<f64>) {
        assert_eq!(world.ncols(), selected.ncols(), "one column a joint");
        let (columns, _) = world.as_slice().as_chunks::<6>();
        let (selected, _) = selected.as_mut_slice().as_chunks_mut::<6>();
        for (column, out) in columns.iter().zip(selected) {
            let [x, y, z, rx, ry, rz] = *column;
            let linear = self.rotation.tr_mul(&Vector3::new(x, y, z));
            let angular = self.rotation.tr_mul(&Vector3::new(rx, ry, rz));
            let rotated = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
            for (out, &axis) in out.iter_mut().zip(self.axes()) {
                *out = rotated[axis] * self.scale[axis];
            }
        }
    }

    /// Replaces the Jacobian `rows` (6 × n) by the result of [`select`](Self::select); unused rows are zero.
    pub fn select_in_place(&self, rows: &mut Matrix6xX<f64>) {
        let (columns, _) = rows.as_mut_slice().as_chunks_mut::<6>();
        for column in columns {
            let [x, y, z, rx, ry, rz] = *column;
            let linear = self.rotation.tr_mul(&Vector3::new(x, y, z));
            let angular = self.rotation.tr_mul(&Vector3::new(rx, ry, rz));
            let rotated = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
            *column = [0.0; 6];
            for (out, &axis) in column.iter_mut().zip(self.axes()) {
                *out = rotated[axis] * self.scale[axis];
            }
        }
    }

    /// Converts a motion from the controlled frame's coordinates to the task axes.
    #[must_use]
    pub fn of_motion(&self, m: &Motion) -> Vector6<f64> {
        let (linear, angular) = (self.rotation.tr_mul(&m.linear), self.rotation.tr_mul(&m.angular));
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// Computes the task's scaled rows of a motion quantity given per axis.
    #[must_use]
    pub fn rows_of(&self, axes: &Vector6<f64>) -> Vector6<f64> {
        let mut rows = Vector6::zeros();
        for (row, &axis) in self.axes().iter().enumerate() {
            rows[row] = axes[axis] * self.scale[axis];
        }
        rows
    }

    /// Computes the task's force rows from a force given per axis. They are divided by the scale that multiplies the
    /// motion rows, so that power is preserved.
    #[must_use]
    pub fn rows_of_force(&self, axes: &Vector6<f64>) -> Vector6<f64> {
        let mut rows = Vector6::zeros();
        for (row, &axis) in self.axes().iter().enumerate() {
            rows[row] = axes[axis] / self.scale[axis];
        }
        rows
    }

    /// Computes the force per axis (N, Nm) from the force rows: the inverse of [`rows_of_force`](Self::rows_of_force).
    #[must_use]
    pub fn force_of_rows(&self, rows: &Vector6<f64>) -> Vector6<f64> {
        let mut axes = Vector6::zeros();
        for (row, &axis) in self.axes().iter().enumerate() {
            axes[axis] = rows[row] * self.scale[axis];
        }
        axes
    }
}
