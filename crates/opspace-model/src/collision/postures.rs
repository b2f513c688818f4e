//! Postures that fill the ranges of the joints evenly.

use crate::configuration::neutral;
use crate::model::{JointKind, Limits, Model};
use std::f64::consts::PI;

/// Low-discrepancy sequence of postures within the joint limits (Roberts' generalised golden ratio), or within a part
/// of each range around its middle. A floating base stays at its neutral pose.
pub(super) struct Postures<'a> {
    model: &'a Model,
    /// Fraction of each range that is used.
    fraction: f64,
    /// Solution of x^(k+1) = x + 1 for k joints.
    ratio: f64,
}

impl<'a> Postures<'a> {
    pub fn new(model: &'a Model, fraction: f64) -> Self {
        let jointed = model.n() - model.first_jointed_body();
        let exponent = 1.0 / (jointed as f64 + 1.0);
        let ratio = (0..64).fold(2.0_f64, |x, _| (1.0 + x).powf(exponent));
        Self { model, fraction, ratio }
    }

    /// Returns the posture with this number (nq; rad, m).
    pub fn posture(&self, number: usize) -> Vec<f64> {
        let mut q = neutral(self.model);
        let first = self.model.first_jointed_body();
        let ahead = self.model.nq() - self.model.n();
        let mut step = 1.0;
        for (i, joint) in self.model.joints().iter().enumerate().skip(first) {
            step /= self.ratio;
            let u = (0.5 + step * (number as f64 + 1.0)).fract();
            let (lower, upper) = range(joint.kind, &joint.limits);
            q[i + ahead] = 0.5 * (lower + upper) + self.fraction * (upper - lower) * (u - 0.5);
        }
        q
    }
}

/// Position range of a joint, rad or m; ±π rad or ±1 m where it has no limit.
fn range(kind: JointKind, limits: &Limits) -> (f64, f64) {
    let far = if kind == JointKind::Prismatic { 1.0 } else { PI };
    let limited = kind != JointKind::Continuous;
    let or_far = |limit: f64, far: f64| if limited && limit.is_finite() { limit } else { far };
    (or_far(limits.lower, -far), or_far(limits.upper, far))
}
