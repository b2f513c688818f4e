//! The rows of a Cartesian task: the axes of a motion that belong to it, scaled to one unit.

use crate::tasks::controlled_frame::ControlledFrame;
use nalgebra::{Matrix3, Matrix6xX, Vector3, Vector6};
use opspace_model::Motion;

/// Directions of a motion. Rotations are multiplied by a length, so that a spectrum over linear
/// and angular rows means the same in any unit of length.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskAxes {
    /// The controlled frame.
    pub controlled: ControlledFrame,
    /// The axes in the controlled frame's coordinates, one a column.
    pub rotation: Matrix3<f64>,
    /// Factors of the six axes: 1, or the characteristic length (m) for rotations.
    pub scale: [f64; 6],
    rows: [usize; 6],
    count: usize,
}

impl TaskAxes {
    /// Those axes of `controlled` that are in the task, by their place in
    /// [`AXIS_NAMES`](crate::tasks::axes::AXIS_NAMES).
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

    /// Axes in the task by their place in [`AXIS_NAMES`](crate::tasks::axes::AXIS_NAMES), in the order of the rows.
    #[must_use]
    pub fn axes(&self) -> &[usize] {
        &self.rows[..self.count]
    }

    /// The rows of the task, scaled, from the controlled frame's Jacobian: into the first rows of `selected`
    /// (6 × n).
    ///
    /// # Panics
    /// If the two differ in size.
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

    /// As [`select`](Self::select), of the Jacobian `rows` in place (6 × n); zeros below the task's rows.
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

    /// A motion in the controlled frame's coordinates, in the task's axes.
    #[must_use]
    pub fn of_motion(&self, m: &Motion) -> Vector6<f64> {
        let (linear, angular) = (self.rotation.tr_mul(&m.linear), self.rotation.tr_mul(&m.angular));
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    /// Computes the task's rows, scaled, of a quantity of motion given axis by axis.
    #[must_use]
    pub fn rows_of(&self, axes: &Vector6<f64>) -> Vector6<f64> {
        let mut rows = Vector6::zeros();
        for (row, &axis) in self.axes().iter().enumerate() {
            rows[row] = axes[axis] * self.scale[axis];
        }
        rows
    }

    /// Computes the task's force rows from a force given axis by axis. They are divided by the scale that multiplies
    /// the motion rows, so that power is preserved.
    #[must_use]
    pub fn rows_of_force(&self, axes: &Vector6<f64>) -> Vector6<f64> {
        let mut rows = Vector6::zeros();
        for (row, &axis) in self.axes().iter().enumerate() {
            rows[row] = axes[axis] / self.scale[axis];
        }
        rows
    }

    /// Computes a force axis by axis (N, Nm) from one given row by row: the reverse of
    /// [`rows_of_force`](Self::rows_of_force).
    #[must_use]
    pub fn force_of_rows(&self, rows: &Vector6<f64>) -> Vector6<f64> {
        let mut axes = Vector6::zeros();
        for (row, &axis) in self.axes().iter().enumerate() {
            axes[axis] = rows[row] * self.scale[axis];
        }
        axes
    }
}
