//! Position, velocity and disturbance of a joint from its encoder: a steady Kalman filter whose prediction comes from
//! whoever knows what the joint was made to do.
//!
//! ```text
//! x = [q, q̇, d]        x = x⁻ + L (y − q⁻)
//! ```
//!
//! d is the acceleration (rad/s²) that the prediction doesn't know of: it wanders at random, and is held between two ticks.

use nalgebra::{Matrix3, RowVector3, Vector3};

/// How fast the unknown acceleration wanders, rad/s² in a root of a second: less follows what a held set-point does within
/// a period less, more follows a wrong model faster.
const WANDERS: f64 = 30.0;

/// What an encoder is off by beside its resolution, rms, rad.
const NOISE_RAD: f64 = 2e-6;

/// Rms of a position that is read to a whole count, as a share of that count (a uniform error has 0.29).
const QUANTISATION: f64 = 0.35;

/// L of a joint: what of an innovation (rad) becomes position, velocity (1/s) and disturbance (1/s²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverGain {
    /// Of the position.
    pub position: f64,
    /// Of the velocity, 1/s.
    pub velocity: f64,
    /// Of the disturbance, 1/s².
    pub disturbance: f64,
}

impl ObserverGain {
    /// For an encoder of this resolution (rad), read every `period_s`: the fixed point of Riccati's recursion.
    #[must_use]
    pub fn steady(resolution_rad: f64, period_s: f64) -> Self {
        let t = period_s;
        let step = Matrix3::new(1.0, t, 0.5 * t * t, 0.0, 1.0, t, 0.0, 0.0, 1.0);
        let wander = Matrix3::from_diagonal(&Vector3::new(0.0, 0.0, WANDERS * WANDERS * t));
        let noise = (QUANTISATION * resolution_rad + NOISE_RAD).powi(2);
        let see = RowVector3::new(1.0, 0.0, 0.0);
        let mut covariance = Matrix3::identity();
        let mut gain = Vector3::zeros();
        // The filter forgets its start within some hundred ticks.
        for _ in 0..20_000 {
            let predicted = step * covariance * step.transpose() + wander;
            let before = gain;
            gain = predicted.column(0) / (predicted[(0, 0)] + noise);
            covariance = (Matrix3::identity() - gain * see) * predicted;
            if (gain - before).amax() <= 1e-12 * gain.amax() {
                break;
            }
        }
        Self { position: gain.x, velocity: gain.y, disturbance: gain.z }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The error dynamics (I − L H) F, whose eigenvalues must lie within the unit circle, for drives from 125 Hz to 4 kHz.
    #[test]
    fn the_filter_is_stable() {
        for period_s in [0.25e-3, 1e-3, 5e-3, 8e-3] {
            for counts in [1e3, 1.6e4, 1e6] {
                let gain = ObserverGain::steady(std::f64::consts::TAU / (counts * 100.0), period_s);
                let t = period_s;
                let step = Matrix3::new(1.0, t, 0.5 * t * t, 0.0, 1.0, t, 0.0, 0.0, 1.0);
                let l = Vector3::new(gain.position, gain.velocity, gain.disturbance);
                let error = (Matrix3::identity() - l * RowVector3::new(1.0, 0.0, 0.0)) * step;
                let largest = error.complex_eigenvalues().iter().map(|v| v.norm()).fold(0.0, f64::max);
                assert!(largest < 0.9999 && gain.position > 0.0, "{period_s} s, {counts} counts: {largest}");
            }
        }
    }
}
