//! Addition and subtraction on the configuration space of the robot.
//!
//! Without a floating base, q is a vector and these are the ordinary sum and difference. With a floating base, q begins
//! with the position and unit quaternion of the base, q̇ begins with the velocity of the base in its own axes, and the
//! base moves along screw motions of SE(3). In Pinocchio `neutral`, `integrate` and `difference`.
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

/// Returns the configuration with all coordinates zero and, for a floating base, the identity rotation (nq). Allocates.
#[must_use]
pub fn neutral(model: &Model) -> Vec<f64> {
    let mut q = vec![0.0; model.nq()];
    if model.is_floating() {
        q[6] = 1.0;
    }
    q
}

/// Computes q ⊕ v (nq) into `out`: the configuration that the robot reaches from `q` (nq) after 1 s at the constant
/// velocity `v` (n).
///
/// # Panics
/// If a slice is too short.
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

/// Computes v with `from` ⊕ v = `to` (nq each) into `out` (n): the constant velocity that moves the robot from `from`
/// to `to` in 1 s. A floating base rotates by at most π.
///
/// # Panics
/// If a slice is too short.
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

/// Returns the left Jacobian of SO(3), ∫₀¹ exp(s ω×) ds, for the rotation vector ω (rad). It maps a constant linear
/// velocity in body axes to the displacement after 1 s.
fn left_jacobian(angular: &Vector3<f64>) -> Matrix3<f64> {
    let angle = angular.norm();
    let w = skew(angular);
    let (a, b) = if angle < SMALL_ANGLE {
        let square = angle * angle;
        (0.5 - square * (1.0 / 24.0 - square / 720.0), 1.0 / 6.0 - square * (1.0 / 120.0 - square / 5_040.0))
    } else {
        // Half-angle formula for 1 − cos, which avoids cancellation.
        let half = (0.5 * angle).sin();
        (2.0 * half * half / (angle * angle), (angle - angle.sin()) / angle.powi(3))
    };
    Matrix3::identity() + w * a + w * w * b
}

/// Returns the inverse of [`left_jacobian`], for angles up to π.
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

/// Angle below which the series are used, rad. Below it, the next term of each series is smaller than rounding errors;
/// above it, the rounding errors of the quotients vanish after multiplication by the square of the angle.
const SMALL_ANGLE: f64 = 1e-2;
