//! A joint's measured closed loop T(s), and the gains of the servo that explains it, without knowledge of its structure: the
//! paper's steps 1) to 5).
//!
//! H(s) is the assumed model of the joint, from torque to position. E is the servo that explains T; if H is the ideal
//! joint G* of equation (K5), E is the paper's D*:
//!
//! ```text
//! E = T/(H (1 − T))                                                 (K6), step 3)
//! q_d = τ/E + q                                               (K8), first form
//! q_d = τ/(E (1 − T)) = H τ/T                                 (K8), second form
//! ```
//!
//! **Literally**, τ is the net torque on a single free joint. Gravity, other joints and contact are not included, and
//! with them 1/E predicts a motion that doesn't happen. The second form doesn't use q, so it drifts. Both are only in the program
//! `opspace-comparisons` of the crate `opspace-testing`. **Split**, 1/E is
//! the sum of a compliance α and a velocity term β s H. The velocity is then measured instead of predicted from the
//! torque, so the split form is valid for arms under gravity and contact:
//!
//! ```text
//! 1/E = α + β s H        q_d = q + α τ + β q̇
//! ```
//!
//! which is equation (K10) with kp = 1/β and kv = β/α.

use crate::polynomial::{product, roots, value};
use crate::servo_gains::ServoGains;
use nalgebra::{Complex, Matrix2, Vector2};
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use thiserror::Error;

/// Relative size of a coefficient, with respect to the largest of its polynomial, that counts as zero.
const NOTHING: f64 = 1e-9;

/// Number of frequencies of the least-squares split of 1/E.
const POINTS: u32 = 60;

/// Largest relative rms residual of the split of 1/E.
const WORST_SPLIT: f64 = 0.3;

/// Ratio of two polynomials in s (rad/s), with coefficients in ascending order from the constant.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TransferFunction {
    /// b₀, b₁, … of b₀ + b₁ s + …
    pub numerator: Vec<f64>,
    /// a₀, a₁, … of a₀ + a₁ s + …
    pub denominator: Vec<f64>,
}

/// Measured closed loop of a joint, and its assumed open loop.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ClosedLoopModel {
    /// T(s), from position setpoint to position.
    pub closed_loop: TransferFunction,
    /// H(s), from torque (Nm, N) to position (rad, m).
    pub open_loop: TransferFunction,
    /// Lowest frequency of the band in which T is accurate, Hz.
    pub from_hz: Positive,
    /// Highest frequency of the band in which T is accurate, Hz.
    pub to_hz: Positive,
}

/// Reason why a joint cannot be inverted from its identified closed loop.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum IdentificationError {
    /// Polynomial that is zero, or missing.
    #[error("{what} is zero or empty")]
    Zero {
        /// Name of the polynomial.
        what: &'static str,
    },
    /// Band from a higher to a lower frequency.
    #[error("to_hz is not above from_hz")]
    Band,
    /// Inverse 1/E that is not the sum of a compliance and a velocity term.
    #[error(
        "1/E is not the sum of a compliance and a velocity term within the band: a fraction of {left:.2} remains, \
         alpha = {alpha:.3e} rad/Nm, beta = {beta:.3e} s"
    )]
    Split {
        /// Compliance α, rad/Nm.
        alpha: f64,
        /// Velocity coefficient β, s.
        beta: f64,
        /// Relative rms residual of the split.
        left: f64,
    },
}

/// Returns the coefficients without negligible highest orders.
fn trimmed(mut polynomial: Vec<f64>) -> Vec<f64> {
    let largest = polynomial.iter().fold(0.0, |largest: f64, c| largest.max(c.abs()));
    while polynomial.last().is_some_and(|c| c.abs() <= NOTHING * NOTHING * largest) {
        polynomial.pop();
    }
    polynomial
}

impl TransferFunction {
    /// Value at `s` (rad/s).
    #[must_use]
    pub fn at(&self, s: Complex<f64>) -> Complex<f64> {
        value(&self.numerator, s) / value(&self.denominator, s)
    }

    /// Returns the ratio of two polynomials without their common powers of s.
    #[must_use]
    pub fn reduced(numerator: Vec<f64>, denominator: Vec<f64>) -> Self {
        let (mut numerator, mut denominator) = (trimmed(numerator), trimmed(denominator));
        let rooted_at_zero = |p: &[f64]| {
            let largest = p.iter().fold(0.0, |largest: f64, c| largest.max(c.abs()));
            p.len() > 1 && p[0].abs() <= NOTHING * largest
        };
        while rooted_at_zero(&numerator) && rooted_at_zero(&denominator) {
            numerator.remove(0);
            denominator.remove(0);
        }
        Self { numerator, denominator }
    }

    /// Largest real part of a pole, rad/s; `None` without poles.
    #[must_use]
    pub fn slowest_pole(&self) -> Option<f64> {
        roots(&self.denominator).iter().map(|pole| pole.re).max_by(f64::total_cmp)
    }
}

impl ClosedLoopModel {
    /// Inverse servo 1/E, rad/Nm.
    #[must_use]
    pub fn inverse_servo(&self) -> TransferFunction {
        let (t, h) = (&self.closed_loop, &self.open_loop);
        let order = t.numerator.len().max(t.denominator.len());
        let of = |p: &[f64], i: usize| p.get(i).copied().unwrap_or(0.0);
        let rest = (0..order).map(|i| of(&t.denominator, i) - of(&t.numerator, i)).collect::<Vec<f64>>();
        TransferFunction::reduced(product(&h.numerator, &rest), product(&h.denominator, &t.numerator))
    }

    /// Checks that the closed loop can be inverted at all.
    ///
    /// # Errors
    /// A polynomial that is zero, or a band from a higher to a lower frequency.
    pub fn check(&self) -> Result<(), IdentificationError> {
        let polynomials = [
            ("closed_loop.numerator", &self.closed_loop.numerator),
            ("closed_loop.denominator", &self.closed_loop.denominator),
            ("open_loop.numerator", &self.open_loop.numerator),
            ("open_loop.denominator", &self.open_loop.denominator),
        ];
        if let Some((what, _)) = polynomials.iter().find(|(_, p)| p.iter().all(|c| *c == 0.0)) {
            return Err(IdentificationError::Zero { what });
        }
        if self.to_hz <= self.from_hz {
            return Err(IdentificationError::Band);
        }
        Ok(())
    }

    /// Returns α (rad/Nm) and β (s) as the stiffness 1/α (Nm/rad) and the damping β/α (Nms/rad): the split of 1/E with
    /// the smallest relative error over the band, by least squares.
    ///
    /// # Errors
    /// If 1/E cannot be inverted, or is not the sum of a compliance and a velocity term.
    pub fn split(&self) -> Result<ServoGains, IdentificationError> {
        self.check()?;
        let inverse = self.inverse_servo();
        let (from, to) = (TAU * self.from_hz.get(), TAU * self.to_hz.get());
        let points = || {
            (0..POINTS).map(|k| {
                let s = Complex::new(0.0, from * (to / from).powf(f64::from(k) / f64::from(POINTS - 1)));
                let whole = inverse.at(s);
                (1.0 / whole, s * self.open_loop.at(s) / whole)
            })
        };
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        for (x, y) in points() {
            for row in [Vector2::new(x.re, y.re), Vector2::new(x.im, y.im)] {
                normal += row * row.transpose();
            }
            right += Vector2::new(x.re, y.re);
        }
        let solved = normal.lu().solve(&right).unwrap_or_default();
        let (alpha, beta) = (solved.x, solved.y);
        let left = points().map(|(x, y)| (x * alpha + y * beta - 1.0).norm_sqr()).sum::<f64>();
        let left = (left / f64::from(POINTS)).sqrt();
        if !(alpha > 0.0 && beta >= 0.0 && left <= WORST_SPLIT) {
            return Err(IdentificationError::Split { alpha, beta, left });
        }
        Ok(ServoGains { stiffness: 1.0 / alpha, damping: beta / alpha })
    }
}
