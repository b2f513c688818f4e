//! Acceleration of the joints by external forces, estimated from the motion.
//!
//! A low-pass filter of the difference between the measured acceleration and the commanded one:
//!
//! ```text
//! d ← d + T/(T_f + T) (Δq̇/T − q̈_commanded − d)          T_f = h/2
//! ```
//!
//! with the control period T and the horizon h of the limits. A momentum observer of first order (De Luca and Mattone,
//! *Actuator failure detection and isolation using generalized momenta*, ICRA 2003) with the inverse of the mass matrix.
//! It contains friction and errors of the model as well, and while torques ramp in, what the ramp withholds. Only
//! the bounds on joints and pairs use it, beyond limits, up to the acceleration with which a joint or a pair brakes.

use nalgebra::DVector;

/// Time constant of the filter, relative to the horizon.
const FILTER_HORIZONS: f64 = 0.5;

/// Estimate of the acceleration by external forces.
pub(crate) struct Push {
    /// Acceleration by external forces, rad/s² or m/s² (n).
    acceleration: DVector<f64>,
    /// Acceleration that the last command causes, rad/s² or m/s² (n).
    commanded: DVector<f64>,
    /// Velocity in the last cycle, rad/s or m/s (n).
    dq: DVector<f64>,
    /// True if `commanded` and `dq` are those of the last cycle.
    known: bool,
    period_s: f64,
    gain: f64,
}

impl Push {
    /// Creates an estimate of zero, for a control period and the horizon of the limits, s.
    pub(crate) fn new(n: usize, period_s: f64, horizon_s: f64) -> Self {
        let zero = DVector::zeros(n);
        Self {
            acceleration: zero.clone(),
            commanded: zero.clone(),
            dq: zero,
            known: false,
            period_s,
            gain: period_s / (FILTER_HORIZONS * horizon_s + period_s),
        }
    }

    /// Sets the estimate to zero.
    pub(crate) fn reset(&mut self) {
        self.acceleration.fill(0.0);
        self.known = false;
    }

    /// Follows the measured velocities, rad/s or m/s (n).
    pub(crate) fn observe(&mut self, dq: &DVector<f64>) {
        if self.known {
            for (i, d) in self.acceleration.iter_mut().enumerate() {
                let external = (dq[i] - self.dq[i]) / self.period_s - self.commanded[i];
                // A measurement that is not a number must not remain in the estimate.
                *d = if external.is_finite() { *d + self.gain * (external - *d) } else { 0.0 };
            }
        }
        self.dq.copy_from(dq);
        self.known = false;
    }

    /// Stores the acceleration that the command of this cycle causes: `alpha` by the tasks, and `bias_acceleration`
    /// (n).
    pub(crate) fn set_commanded(&mut self, alpha: &DVector<f64>, bias_acceleration: &DVector<f64>) {
        self.commanded.copy_from(alpha);
        self.commanded += bias_acceleration;
        self.known = true;
    }

    /// Acceleration that the last command causes, rad/s² or m/s² (n).
    pub(crate) fn commanded(&self) -> &[f64] {
        self.commanded.as_slice()
    }

    /// Acceleration by external forces, rad/s² or m/s² (n).
    pub(crate) fn acceleration(&self) -> &[f64] {
        self.acceleration.as_slice()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A joint at rest is accelerated by 3 rad/s² that nobody commanded. The estimate reaches them, also after a velocity that is
    /// not a number, and a start forgets them.
    #[test]
    fn estimate_follows_uncommanded_acceleration() {
        const ROUNDING: f64 = 1e-6;
        let (one, none) = (DVector::from_element(1, 1.0), DVector::zeros(1));
        let mut push = Push::new(1, 1e-3, 0.02);
        for cycle in 0..300 {
            let is_missing = cycle == 100;
            let dq = if is_missing { f64::NAN } else { 4e-3 * f64::from(cycle) };
            push.observe(&(&one * dq));
            push.set_commanded(&one, &none);
        }
        assert!((push.acceleration()[0] - 3.0).abs() < ROUNDING, "{:?}", push.acceleration());
        push.reset();
        assert_eq!(push.acceleration(), [0.0]);
    }
}
