//! Orientations: the logarithm and exponential of SO(3), and orientation errors on selected axes.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Returns the rotation vector (rad) of a rotation: its axis times its angle, which is at most π.
///
/// The angle is computed by the arctangent of the quaternion's parts, which is accurate at both ends of [0, π].
#[must_use]
pub fn log(rotation: &Matrix3<f64>) -> Vector3<f64> {
    log_quaternion(&quaternion(rotation))
}

/// Returns the rotation about `vector` by an angle equal to its length, rad.
#[must_use]
pub fn exp(vector: &Vector3<f64>) -> Matrix3<f64> {
    *UnitQuaternion::from_scaled_axis(*vector).to_rotation_matrix().matrix()
}

/// Returns the rotation of fixed-axis roll, pitch and yaw, rad (as in URDF).
#[must_use]
pub fn from_rpy(rpy: [f64; 3]) -> Matrix3<f64> {
    *Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]).matrix()
}

/// Returns the unit quaternion of a rotation, with a non-negative scalar part.
#[must_use]
pub fn quaternion(rotation: &Matrix3<f64>) -> Quaternion<f64> {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation)).into_inner();
    if q.w < 0.0 { -q } else { q }
}

fn log_quaternion(q: &Quaternion<f64>) -> Vector3<f64> {
    let (w, v) = if q.w < 0.0 { (-q.w, -q.imag()) } else { (q.w, q.imag()) };
    let norm = v.norm();
    // The ratio tends to 2 at norm = 0. v can still be non-zero, with squares that underflow.
    if norm > 0.0 { v * (2.0 * norm.atan2(w) / norm) } else { v * 2.0 }
}

/// Returns the rotation vector (rad) of `rotation`, restricted to the axes in `counted`; its other components are zero.
///
/// Three axes: the logarithm. Two axes: `rotation` is split into a twist about the third axis followed by a swing about
/// an axis perpendicular to it; the swing is the error and does not change if the frame rotates about the third axis.
/// One axis: the angle of the twist about it.
#[must_use]
pub fn log_about(rotation: &Matrix3<f64>, counted: [bool; 3]) -> Vector3<f64> {
    let q = quaternion(rotation);
    let differs = |i: usize, j: usize| counted[i] != counted[j % 3];
    let Some(split) = (0..3).find(|&i| differs(i, i + 1) && differs(i, i + 2)) else {
        return if counted[0] { log_quaternion(&q) } else { Vector3::zeros() };
    };
    let turn = Quaternion::from_parts(q.w, Vector3::ith(split, q.imag()[split]));
    if counted[split] {
        return log_quaternion(&turn);
    }
    let norm = turn.norm();
    // The twist is undefined for a swing by π.
    let swing = if norm > 0.0 { q * turn.conjugate() / norm } else { q };
    let mut error = log_quaternion(&swing);
    error[split] = 0.0;
    error
}

/// Returns the angular velocity (rad/s) and angular acceleration (rad/s²) of exp(φ) from φ, φ̇ and φ̈, in the axes of
/// φ.
///
/// ```text
/// ω = φ̇ + B φ × φ̇ + C φ × (φ × φ̇)      B = (1 − cos θ)/θ²,  C = (θ − sin θ)/θ³,  θ = |φ|
/// ```
///
/// The formula of ω is the left Jacobian of SO(3) (Chirikjian, *Stochastic Models, Information Theory, and Lie Groups*
/// 2, §10.6); the angular acceleration is its time derivative.
#[must_use]
pub fn rotation_vector_rates(
    phi: &Vector3<f64>,
    dphi: &Vector3<f64>,
    ddphi: &Vector3<f64>,
) -> (Vector3<f64>, Vector3<f64>) {
    let [b, c, b_slope, c_slope] = left_jacobian_coefficients(phi.norm());
    let along = phi.dot(dphi);
    let once = phi.cross(dphi);
    let twice = phi.cross(&once);
    let omega = dphi + once * b + twice * c;
    let alpha = ddphi
        + once * (b_slope * along)
        + phi.cross(ddphi) * b
        + twice * (c_slope * along)
        + (dphi.cross(&once) + phi.cross(&phi.cross(ddphi))) * c;
    (omega, alpha)
}

/// B, C, (dB/dθ)/θ and (dC/dθ)/θ.
fn left_jacobian_coefficients(theta: f64) -> [f64; 4] {
    let squared = theta * theta;
    // For small θ the closed forms lose more digits by cancellation than the series, whose next terms are below 1e-12.
    if theta < 0.2 {
        let series = |a: [f64; 4]| a[0] + squared * (a[1] + squared * (a[2] + squared * a[3]));
        return [
            series([1.0 / 2.0, -1.0 / 24.0, 1.0 / 720.0, -1.0 / 40_320.0]),
            series([1.0 / 6.0, -1.0 / 120.0, 1.0 / 5_040.0, -1.0 / 362_880.0]),
            series([-1.0 / 12.0, 1.0 / 180.0, -1.0 / 6_720.0, 1.0 / 453_600.0]),
            series([-1.0 / 60.0, 1.0 / 1_260.0, -1.0 / 60_480.0, 1.0 / 4_989_600.0]),
        ];
    }
    let (sin, cos) = theta.sin_cos();
    [
        (1.0 - cos) / squared,
        (theta - sin) / (squared * theta),
        (theta * sin - 2.0 * (1.0 - cos)) / (squared * squared),
        (3.0 * sin - 2.0 * theta - theta * cos) / (squared * squared * theta),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn axis() -> Vector3<f64> {
        Vector3::new(0.48, -0.6, 0.64)
    }

    /// Compared: the logarithm with the vector from which nalgebra's exponential (Rodrigues' formula) built the matrix.
    #[test]
    fn log_inverts_rodrigues_from_zero_to_pi() {
        for angle in [0.0, 1e-200, 1e-12, 1e-7, 1e-3, 0.5, 2.0, 3.0, PI - 1e-3, PI - 1e-7, PI - 1e-9] {
            let vector = axis() * angle;
            let rotation = *Rotation3::new(vector).matrix();
            let error = (log(&rotation) - vector).norm();
            assert!(error < 4e-15 * (1.0 + angle), "angle {angle}: off by {error}");
        }
    }

    /// Compared: length and line of the logarithm at π, where both signs of the axis are correct.
    #[test]
    fn log_of_half_turn_has_length_pi() {
        for axis in [axis(), Vector3::x(), Vector3::y(), Vector3::z()] {
            let rotation = axis * axis.transpose() * 2.0 - Matrix3::identity();
            let vector = log(&rotation);
            assert!((vector.norm() - PI).abs() < 1e-14);
            assert!(vector.cross(&axis).norm() < 1e-14, "{vector} is not along {axis}");
        }
    }

    /// Compared: swing and twist, composed again, with the original rotation; and the swing before and after a further
    /// rotation of the frame about the free axis.
    #[test]
    fn error_ignores_rotation_about_free_axis() {
        let rotation = exp(&Vector3::new(0.7, -0.4, 1.1));
        for free in 0..3 {
            let mut counted = [true; 3];
            counted[free] = false;
            let swing = log_about(&rotation, counted);
            assert!(swing[free] == 0.0);
            let turn = exp(&swing).transpose() * rotation;
            let mut only = [false; 3];
            only[free] = true;
            let left = exp(&log_about(&rotation, only)) - turn;
            assert!(left.norm() < 1e-14, "axis {free}: {left}");
            for angle in [0.5, -2.5] {
                let turned = rotation * exp(&Vector3::ith(free, angle));
                assert!((log_about(&turned, counted) - swing).norm() < 1e-14);
            }
        }
        assert!(log_about(&rotation, [true; 3]) == log(&rotation));
    }

    /// Compared: ω and ω̇ with central differences of the matrix exp(φ(t)), on both sides of the limit of the series.
    #[test]
    fn rotation_vector_rates_match_exponential_differences() {
        let path = |size: f64, t: f64| {
            [
                Vector3::new((1.3 * t).sin(), (0.7 * t).cos(), 0.4 * t * t) * size,
                Vector3::new(1.3 * (1.3 * t).cos(), -0.7 * (0.7 * t).sin(), 0.8 * t) * size,
                Vector3::new(-1.69 * (1.3 * t).sin(), -0.49 * (0.7 * t).cos(), 0.8) * size,
            ]
        };
        let omega_at = |size: f64, t: f64| {
            let [phi, dphi, ddphi] = path(size, t);
            rotation_vector_rates(&phi, &dphi, &ddphi)
        };
        let h = 1e-5;
        for size in [1e-6, 0.1, 0.15, 0.2, 0.3, 1.0, 2.0] {
            for t in [0.1, 0.6, 1.1] {
                let (omega, alpha) = omega_at(size, t);
                let difference = exp(&path(size, t + h)[0]) * exp(&path(size, t - h)[0]).transpose();
                let numeric = log(&difference) / (2.0 * h);
                assert!((omega - numeric).norm() < 1e-9 * (1.0 + size), "size {size}, t {t}");
                let numeric = (omega_at(size, t + h).0 - omega_at(size, t - h).0) / (2.0 * h);
                assert!((alpha - numeric).norm() < 1e-9 * (1.0 + size), "size {size}, t {t}");
            }
        }
    }

    #[test]
    fn series_and_closed_form_agree() {
        let below = left_jacobian_coefficients(0.2 - 1e-13);
        let above = left_jacobian_coefficients(0.2);
        for (b, a) in below.iter().zip(above) {
            assert!((b - a).abs() < 1e-12, "{b} against {a}");
        }
    }
}
