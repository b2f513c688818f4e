//! Estimation of joint velocity from positions: finite difference at the interface rate, then a first-order low-pass.
//!
//! This is the paper's estimate (§III: "estimated with the available data and then filtered with a low
//! pass filter").

use nalgebra::DVector;
use opspace_backend::low_pass;
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Estimation of joint velocity.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EstimatorParameters {
    /// Cut-off of the low-pass on the finite difference, Hz.
    pub velocity_filter_hz: Positive,
}

impl Default for EstimatorParameters {
    /// Returns the cut-off of the paper's experiments, 150 Hz.
    fn default() -> Self {
        Self { velocity_filter_hz: Positive::literal(150.0) }
    }
}

/// Velocity estimator of n joints: `w += a ((y − y₋)/T − w)` with `a = 1 − exp(−2π f T)`; T is longer where samples are
/// missed.
#[derive(Clone, Debug)]
pub struct VelocityEstimator {
    period_s: f64,
    gain: f64,
    /// Last positions; NaN before the first.
    last: DVector<f64>,
    velocity: DVector<f64>,
}

impl VelocityEstimator {
    /// Returns an estimator at rest; `period_s` between two positions.
    #[must_use]
    pub fn new(n: usize, parameters: &EstimatorParameters, period_s: f64) -> Self {
        let gain = low_pass::gain(parameters.velocity_filter_hz.get(), period_s);
        Self { period_s, gain, last: DVector::from_element(n, f64::NAN), velocity: DVector::zeros(n) }
    }

    /// Returns the velocity (rad/s or m/s) with the new positions `q` (n; rad or m); 0 with the first.
    pub fn update(&mut self, q: &[f64]) -> &[f64] {
        self.update_after(1, q)
    }

    /// Returns the velocity as [`update`](Self::update) does, with positions that come that many periods after the
    /// last.
    pub fn update_after(&mut self, periods: u64, q: &[f64]) -> &[f64] {
        let elapsed_s = periods as f64 * self.period_s;
        let gain = if periods == 1 { self.gain } else { 1.0 - (1.0 - self.gain).powf(periods as f64) };
        for (i, &q) in q.iter().enumerate() {
            let difference = (q - self.last[i]) / elapsed_s;
            if difference.is_finite() {
                self.velocity[i] += gain * (difference - self.velocity[i]);
            }
        }
        self.last.copy_from_slice(q);
        self.velocity.as_slice()
    }

    /// Resets the estimator: the next positions are the first.
    pub fn reset(&mut self) {
        self.last.fill(f64::NAN);
        self.velocity.fill(0.0);
    }
}
