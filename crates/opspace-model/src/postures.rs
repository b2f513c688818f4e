//! Postures that fill the ranges of the joints evenly.

use crate::configuration::neutral;
use crate::model::Model;

/// Low-discrepancy sequence of postures within the joint limits (Roberts' generalised golden ratio), or within a part
/// of each range around its middle. A floating base stays at its neutral pose.
#[derive(Clone, Debug)]
pub struct Postures<'a> {
    model: &'a Model,
    /// Fraction of each range that is used.
    fraction: f64,
    /// Solution of x^(k+1) = x + 1 for k joints.
    ratio: f64,
}

impl<'a> Postures<'a> {
    /// Creates the sequence for this `fraction` of each range, from 0 to 1. Joints without limits have ±π rad or ±1 m.
    #[must_use]
    pub fn new(model: &'a Model, fraction: f64) -> Self {
        let jointed = model.n() - model.first_jointed_body();
        let exponent = 1.0 / (jointed as f64 + 1.0);
        let ratio = (0..64).fold(2.0_f64, |x, _| (1.0 + x).powf(exponent));
        Self { model, fraction, ratio }
    }

    /// Returns the posture with this number (nq; rad, m).
    #[must_use]
    pub fn posture(&self, number: usize) -> Vec<f64> {
        let mut q = neutral(self.model);
        let first = self.model.first_jointed_body();
        let ahead = self.model.nq() - self.model.n();
        let mut step = 1.0;
        for (i, joint) in self.model.joints().iter().enumerate().skip(first) {
            step /= self.ratio;
            let u = (0.5 + step * (number as f64 + 1.0)).fract();
            let (lower, upper) = joint.limits.range(joint.kind);
            q[i + ahead] = 0.5 * (lower + upper) + self.fraction * (upper - lower) * (u - 0.5);
        }
        q
    }
}
