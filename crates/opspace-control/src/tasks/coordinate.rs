//! Coordinates: functions of the joint positions that a task can control.

use nalgebra::{Matrix6xX, Vector6};
use opspace_model::{Data, Model};

/// One to six functions x(q) of the joint positions.
///
/// All methods must be valid at any state and must not allocate.
pub trait Coordinate: Send + 'static {
    /// Number of functions, from 1 to 6; 1 unless the coordinate has more.
    fn rows(&self) -> usize {
        1
    }

    /// x at the state of `data`; only the first [`rows`](Self::rows) elements are used.
    fn value(&self, model: &Model, data: &Data) -> Vector6<f64>;

    /// Computes ∂x/∂q (6 × n) at the state of `data`; rows after the first [`rows`](Self::rows) are zero.
    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>);

    /// J̇ q̇ at the state of `data`: ẍ with q̈ = 0.
    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64>;

    /// Difference `to` − `from` of one element; between −π and π for an angle.
    fn difference(&self, _row: usize, to: f64, from: f64) -> f64 {
        to - from
    }

    /// Name and unit of an element, for signals and error messages.
    fn element(&self, row: usize) -> (&'static str, &'static str);
}
