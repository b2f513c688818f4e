//! Configuration space of the robot: sums and differences on it.
//!
//! Without a floating base q is n numbers and these are plain sums. With one, q begins with its position and unit
//! quaternion, q̇ with its velocity in its own axes, and steps go along the screw motions of SE(3). In Pinocchio
//! `neutral`, `integrate` and `difference`.
//!
//! ```
//! use opspace_model::{Inertia, Model, difference, integrate, neutral};
//! let model = Model::floating("box", Inertia { mass: 1.0, ..Inertia::zero() });
//! let (mut q, mut back) = ([0.0; 7], [0.0; 6]);
//! let start = neutral(&model);
//! let step = [0.1, 0.0, 0.0, 0.0, 0.0, 1.5];
//! integrate(&model, &start, &step, &mut q);
//! difference(&model, &start, &q, &mut back);
//! assert!(step.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
//! ```

use crate::model::Model;
use crate::spatial::skew;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Configuration of all zeros, a floating base not turned (nq). Allocates.
#[must_use]
pub fn neutral(model: &Model) -> Vec<f64> {
    let mut q = vec![0.0; model.nq()];
    if model.is_floating() {
        q[6] = 1.0;
    }
    q
}

/// Configuration q ⊕ v that the robot reaches at the constant velocity `v` (n) in 1 s from `q` (nq), into `out` (nq).
///
/// # Panics
/// If a slice is shorter than that.
pub fn integrate(model: &Model, q: &[f64], v: &[f64], out: &mut [f64]) {
    let (mut q, mut v, mut out) = (&q[..model.nq()], &v[..model.n()], &mut out[..model.nq()]);
    if model.is_floating() {
        let (position, rotation) = pose(q);
        let (linear, angular) = (Vector3::from_column_slice(&v[..3]), Vector3::from_column_slice(&v[3..6]));
        let moved = position + rotation * (left_jacobian(&angular) * linear);
        let mut turned = rotation * UnitQuaternion::from_scaled_axis(angular);
        turned.renormalize();
        out[..3].copy_from_slice(moved.as_slice());
        out[3..7].copy_from_slice(turned.coords.as_slice());
        (q, v, out) = (&q[7..], &v[6..], &mut out[7..]);
    }
    for ((out, q), v) in out.iter_mut().zip(q).zip(v) {
        *out = q + v;
    }
}

/// Velocity v with `from` ⊕ v = `to` (nq each), into `out` (n): the constant velocity that moves the robot from one
/// to the other in 1 s, a floating base turning by π at most.
///
/// # Panics
/// If a slice is shorter than that.
pub fn difference(model: &Model, from: &[f64], to: &[f64], out: &mut [f64]) {
    let (mut from, mut to, mut out) = (&from[..model.nq()], &to[..model.nq()], &mut out[..model.n()]);
    if model.is_floating() {
        let ((start, turned_from), (end, turned_to)) = (pose(from), pose(to));
        let angular = (turned_from.inverse() * turned_to).scaled_axis();
        let linear = inverse_left_jacobian(&angular) * (turned_from.inverse() * (end - start));
        out[..3].copy_from_slice(linear.as_slice());
        out[3..6].copy_from_slice(angular.as_slice());
        (from, to, out) = (&from[7..], &to[7..], &mut out[6..]);
    }
    for ((out, from), to) in out.iter_mut().zip(from).zip(to) {
        *out = to - from;
    }
}

fn pose(q: &[f64]) -> (Vector3<f64>, UnitQuaternion<f64>) {
    (
        Vector3::from_column_slice(&q[..3]),
        UnitQuaternion::new_normalize(Quaternion::new(q[6], q[3], q[4], q[5])),
    )
}

/// Left Jacobian ∫₀¹ exp(s ω×) ds: the mean rotation of a body that turns by ω, which maps its velocity to its path.
fn left_jacobian(angular: &Vector3<f64>) -> Matrix3<f64> {
    let angle = angular.norm();
    let w = skew(angular);
    let (a, b) = if angle < SMALL_ANGLE {
        let square = angle * angle;
        (0.5 - square * (1.0 / 24.0 - square / 720.0), 1.0 / 6.0 - square * (1.0 / 120.0 - square / 5_040.0))
    } else {
        // 1 − cos by the half angle: nothing cancels.
        let half = (0.5 * angle).sin();
        (2.0 * half * half / (angle * angle), (angle - angle.sin()) / angle.powi(3))
    };
    Matrix3::identity() + w * a + w * w * b
}

/// Inverse of [`left_jacobian`], for angles up to π.
fn inverse_left_jacobian(angular: &Vector3<f64>) -> Matrix3<f64> {
    let angle = angular.norm();
    let w = skew(angular);
    let b = if angle < SMALL_ANGLE {
        let square = angle * angle;
        1.0 / 12.0 + square * (1.0 / 720.0 + square / 30_240.0)
    } else {
        (1.0 - 0.5 * angle / (0.5 * angle).tan()) / (angle * angle)
    };
    Matrix3::identity() - w * 0.5 + w * w * b
}

/// Angle below which the next term of each series is lost in rounding, rad; above it the quotients' own rounding is,
/// where they are multiplied with the angle's square.
const SMALL_ANGLE: f64 = 1e-2;
