//! Fading of the difference between a target and a reference, and displacement of a pose.
//!
//! ```text
//! x = x_d + p(t)        R = exp(φ(t)) R_d        p(T) = φ(T) = 0
//! ```
//!
//! p and φ are [quintic polynomials](crate::references::ramp) from the difference at the beginning, with its first two derivatives,
//! to rest at zero. The angular velocity follows from that of the rotation vector φ.

use crate::orientation;
use crate::orientation::rotation_vector_rates;
use crate::references::ramp::Quintic;
use crate::references::target::Target;
use nalgebra::{Matrix3, Vector3};
use opspace_model::{Motion, Placement};

/// Fading difference between a target and its reference: a displacement (m) and a rotation vector (rad), in world axes.
#[derive(Clone, Debug)]
pub(crate) struct Joining {
    begin_s: f64,
    end_s: f64,
    line: [Quintic; 3],
    turn: [Quintic; 3],
}

impl Joining {
    /// Creates the blend from the target `from` at the time `begin_s` to a reference in `lasts_s` (s). `reference` is
    /// its value at `begin_s`.
    pub(crate) fn new(begin_s: f64, lasts_s: f64, from: &Target, reference: &Target) -> Self {
        let line = [
            from.placement.translation - reference.placement.translation,
            from.velocity.linear - reference.velocity.linear,
            from.acceleration.linear - reference.acceleration.linear,
        ];
        let away = from.placement.rotation * reference.placement.rotation.transpose();
        // ω = ω_away + E ω_reference with E = exp(φ), and the time derivative of this equation. ω_away is linear in φ̇,
        // its derivative is linear in φ̈.
        let phi = orientation::log(&away);
        let rotated = away * reference.velocity.angular;
        let omega = from.velocity.angular - rotated;
        let alpha = from.acceleration.angular - away * reference.acceleration.angular - omega.cross(&rotated);
        let zero = Vector3::zeros();
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()]
            .map(|axis| rotation_vector_rates(&phi, &axis, &zero).0);
        // The matrix is invertible below a full turn, and the logarithm is at most half a turn.
        let inverse = Matrix3::from_columns(&columns).try_inverse().unwrap_or_else(Matrix3::identity);
        let dphi = inverse * omega;
        let ddphi = inverse * (alpha - rotation_vector_rates(&phi, &dphi, &zero).1);
        let fading =
            |[x, v, a]: [Vector3<f64>; 3]| [0, 1, 2].map(|i| Quintic::new([x[i], v[i], a[i]], 0.0, lasts_s));
        Self { begin_s, end_s: begin_s + lasts_s, line: fading(line), turn: fading([phi, dphi, ddphi]) }
    }

    /// Returns the target for the value of the reference at `time_s`.
    pub(crate) fn blended(&self, reference: &Target, time_s: f64) -> Target {
        if time_s < self.end_s { self.target(reference, time_s) } else { *reference }
    }

    fn target(&self, reference: &Target, time_s: f64) -> Target {
        let at = |part: &[Quintic; 3]| {
            let [x, y, z] = [0, 1, 2].map(|i| part[i].at(time_s - self.begin_s));
            [0, 1, 2].map(|k| Vector3::new(x[k], y[k], z[k]))
        };
        let (line, [phi, dphi, ddphi]) = (at(&self.line), at(&self.turn));
        let (omega, alpha) = rotation_vector_rates(&phi, &dphi, &ddphi);
        let away = orientation::exp(&phi);
        let rotated = away * reference.velocity.angular;
        Target {
            placement: Placement {
                rotation: away * reference.placement.rotation,
                translation: reference.placement.translation + line[0],
            },
            velocity: Motion { linear: reference.velocity.linear + line[1], angular: omega + rotated },
            acceleration: Motion {
                linear: reference.acceleration.linear + line[2],
                angular: alpha + away * reference.acceleration.angular + omega.cross(&rotated),
            },
        }
    }
}

/// Returns the pose `from`, displaced by a translation (m) and a rotation vector (rad) with their first two
/// derivatives, in world axes.
pub(crate) fn moved(from: &Placement, line: [Vector3<f64>; 3], turn: [Vector3<f64>; 3]) -> Target {
    let (omega, alpha) = rotation_vector_rates(&turn[0], &turn[1], &turn[2]);
    Target {
        placement: Placement {
            rotation: orientation::exp(&turn[0]) * from.rotation,
            translation: from.translation + line[0],
        },
        velocity: Motion { linear: line[1], angular: omega },
        acceleration: Motion { linear: line[2], angular: alpha },
    }
}

/// Returns `target` after a rotation by `turn` and a translation by `shift` in the world, and a rotation of its own
/// axes by `own`.
pub(crate) fn laid(target: &Target, turn: &Matrix3<f64>, shift: &Vector3<f64>, own: &Matrix3<f64>) -> Target {
    let Target { placement, velocity, acceleration } = target;
    let turned = |motion: &Motion| Motion { linear: turn * motion.linear, angular: turn * motion.angular };
    Target {
        placement: Placement {
            translation: shift + turn * placement.translation,
            rotation: turn * placement.rotation * own,
        },
        velocity: turned(velocity),
        acceleration: turned(acceleration),
    }
}
