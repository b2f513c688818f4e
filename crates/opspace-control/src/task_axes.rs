//! The rows of a Cartesian task: the axes of a frame's motion that belong to it, scaled to one unit.

use nalgebra::{Matrix3, Matrix6xX, Vector6};
use opspace_model::{FrameId, Motion};

/// Directions of a frame's motion. Rotations are multiplied by a length, so that a spectrum over linear
/// and angular rows means the same in any unit of length.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskAxes {
    /// The frame that moves.
    pub frame: FrameId,
    /// The axes in the world, one a column.
    pub rotation: Matrix3<f64>,
    /// By how much each of the six axes is multiplied: 1, or the characteristic length (m) for rotations.
    pub scale: [f64; 6],
    rows: [usize; 6],
    count: usize,
}

impl TaskAxes {
    /// Those axes of `frame` that are in the task, by their place in
    /// [`AXIS_NAMES`](crate::axes::AXIS_NAMES).
    #[must_use]
    pub fn new(frame: FrameId, rotation: Matrix3<f64>, in_task: [bool; 6], length_m: f64) -> Self {
        let mut rows = [0; 6];
        let mut count = 0;
        for (axis, _) in in_task.iter().enumerate().filter(|(_, used)| **used) {
            rows[count] = axis;
            count += 1;
        }
        let scale = [1.0, 1.0, 1.0, length_m, length_m, length_m];
        Self { frame, rotation, scale, rows, count }
    }

    /// How many axes are in the task.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.count
    }

    /// Which they are, in the order of the rows.
    #[must_use]
    pub fn axes(&self) -> &[usize] {
        &self.rows[..self.count]
    }

    /// The rows of the task, scaled, from the Jacobian in world axes: into the first rows of `selected`
    /// (6 × n).
    ///
    /// # Panics
    /// If the two differ in size.
    pub fn select(&self, world: &Matrix6xX<f64>, selected: &mut Matrix6xX<f64>) {
        for (column, mut out) in world.column_iter().zip(selected.column_iter_mut()) {
            for (row, &axis) in self.axes().iter().enumerate() {
                let direction = self.rotation.column(axis % 3);
                let part = column.fixed_rows::<3>(if axis < 3 { 0 } else { 3 });
                out[row] = direction.dot(&part) * self.scale[axis];
            }
        }
    }

    /// A motion given in world axes, in the task's.
    #[must_use]
    pub fn of_motion(&self, m: &Motion) -> Vector6<f64> {
        let (linear, angular) = (self.rotation.tr_mul(&m.linear), self.rotation.tr_mul(&m.angular));
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }
}
