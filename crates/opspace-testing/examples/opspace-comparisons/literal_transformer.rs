//! Equation (K8) on a measured closed loop, applied literally, for comparisons: it can damage a real robot.
//!
//! ```text
//! q_desired = τ/E + q                                               first form
//! q_desired = τ/(E (1 − T)) = H τ/T                                 second form
//! ```
//!
//! T, H and E are those of [`ClosedLoopModel`]. τ is the net torque on a single free joint, without gravity and contact. The
//! second form doesn't use q, so it drifts.

use nalgebra::DVector;
use opspace_backend::Sample;
use opspace_model::Data;
use opspace_transformer::polynomial::product;
use opspace_transformer::{ClosedLoopModel, IdentificationError, TransferFunction, Transformer};
use thiserror::Error;

/// Largest real part of a pole that counts as stable, rad/s.
const NOTHING: f64 = 1e-9;

/// Reason why a joint's closed loop cannot be inverted literally.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LiteralError {
    /// Closed loop that cannot be inverted at all.
    #[error(transparent)]
    Model(#[from] IdentificationError),
    /// Closed loop that rolls off faster than the open loop: q_desired would depend on the rate of the torque.
    #[error(
        "closed_loop rolls off faster than open_loop (by {excess} powers of s): setpoints would depend on the rate of \
         the torque"
    )]
    Improper {
        /// Excess powers of s.
        excess: usize,
    },
    /// Unstable inverse: setpoints would grow without bound.
    #[error(
        "setpoints would be unbounded: closed_loop has a zero, or open_loop a pole, at s = {at:.3} rad/s"
    )]
    Unstable {
        /// Real part of the zero or pole, rad/s.
        at: f64,
    },
}

/// Transfer function in s, discretized for the period `period_s` by Tustin's rule.
#[derive(Clone, Debug)]
struct Filter {
    numerator: Vec<f64>,
    denominator: Vec<f64>,
    memory: Vec<f64>,
}

impl Filter {
    fn new(rational: &TransferFunction, period_s: f64) -> Self {
        let order = rational.denominator.len() - 1;
        let discrete = |p: &[f64]| {
            let mut sum = vec![0.0; order + 1];
            for (i, c) in p.iter().enumerate() {
                // c (2/T)^i (1 − z⁻¹)^i (1 + z⁻¹)^(order − i)
                let mut term = vec![c * (2.0 / period_s).powi(i as i32)];
                for k in 0..order {
                    term = product(&term, if k < i { &[1.0, -1.0] } else { &[1.0, 1.0] });
                }
                sum.iter_mut().zip(term).for_each(|(sum, c)| *sum += c);
            }
            sum
        };
        let (mut numerator, mut denominator) =
            (discrete(&rational.numerator), discrete(&rational.denominator));
        let first = denominator[0];
        numerator.iter_mut().chain(&mut denominator).for_each(|c| *c /= first);
        Self { numerator, denominator, memory: vec![0.0; order + 1] }
    }

    /// Computes the next output, in the transposed direct form.
    fn step(&mut self, input: f64) -> f64 {
        let output = self.numerator[0] * input + self.memory[0];
        for i in 1..self.numerator.len() {
            self.memory[i - 1] = self.numerator[i] * input - self.denominator[i] * output + self.memory[i];
        }
        output
    }
}

/// Transformer by equation (K8), applied literally: valid for a single free joint.
#[derive(Clone, Debug)]
pub struct LiteralTransformer {
    joints: Vec<Filter>,
    /// True if the measured q is used; otherwise the position at the start.
    measured: bool,
    start: DVector<f64>,
    begun: bool,
}

impl LiteralTransformer {
    /// Returns the transformer for joints with these models, called every `period_s` (s). If `measured` is true it uses
    /// the measured position (first form), otherwise it doesn't (second form).
    ///
    /// # Errors
    /// Index of the first joint that cannot be inverted, and the reason.
    pub fn new(
        joints: &[ClosedLoopModel],
        measured: bool,
        period_s: f64,
    ) -> Result<Self, (usize, LiteralError)> {
        let filter = |joint: &ClosedLoopModel| {
            joint.check()?;
            let (t, h) = (&joint.closed_loop, &joint.open_loop);
            let rational = if measured {
                joint.inverse_servo()
            } else {
                let numerator = product(&h.numerator, &t.denominator);
                TransferFunction::reduced(numerator, product(&h.denominator, &t.numerator))
            };
            if let Some(excess) = rational.numerator.len().checked_sub(rational.denominator.len() + 1) {
                return Err(LiteralError::Improper { excess: excess + 1 });
            }
            // The integration from velocity to position, a pole at zero, counts as stable.
            let slowest = rational.slowest_pole().unwrap_or(f64::NEG_INFINITY);
            if slowest > NOTHING {
                return Err(LiteralError::Unstable { at: slowest });
            }
            Ok(Filter::new(&rational, period_s))
        };
        let joints: Result<Vec<Filter>, _> =
            joints.iter().enumerate().map(|(i, joint)| filter(joint).map_err(|e| (i, e))).collect();
        let joints = joints?;
        let start = DVector::zeros(joints.len());
        Ok(Self { joints, measured, start, begun: false })
    }
}

impl Transformer for LiteralTransformer {
    fn observe(&mut self, sample: &Sample) -> Option<&[f64]> {
        if !self.begun {
            self.start.copy_from_slice(&sample.q);
        }
        None
    }

    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        self.begun = true;
        let from = if self.measured { &data.q } else { &self.start };
        for (i, filter) in self.joints.iter_mut().enumerate() {
            q_desired[i] = from[i] + filter.step(tau[i]);
        }
    }

    fn reset(&mut self) {
        self.begun = false;
        self.joints.iter_mut().for_each(|filter| filter.memory.fill(0.0));
    }
}
