//! Rational model of a measured frequency response, with separate delay and hold.
//!
//! ```text
//! T(jω) ≈ hold(jω) e^{−jω t_d} N(jω)/D(jω)        hold(jω) = (1 − e^{−jωT})/(jωT)
//! ```
//!
//! C. K. Sanathanan, J. Koerner, *Transfer function synthesis as a ratio of two complex polynomials*, IEEE Trans.
//! Automatic Control 8(1), 1963: iterated linear least squares in the coefficients, weighted by the denominator of the
//! previous iteration.

use nalgebra::{Complex, DMatrix, DVector};
use opspace_transformer::TransferFunction;
use opspace_transformer::polynomial::value;
use serde::Serialize;
use std::f64::consts::TAU;

const ROUNDS: usize = 30;

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per column.
pub(crate) const MAX_ITERATIONS: usize = 1000;

/// Measured value of the response at one frequency.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Frequency, Hz.
    pub hz: f64,
    /// Value of T.
    pub value: Complex<f64>,
    /// Weight in the fit.
    pub weight: f64,
}

/// Rational function N(s)/D(s) in series with a hold and a delay.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DelayedTransferFunction {
    /// N(s)/D(s), with the constant coefficient of D equal to 1.
    #[serde(flatten)]
    pub rational: TransferFunction,
    /// Duration of the hold of the input, s.
    pub hold_s: f64,
    /// Delay until the input acts, s.
    pub delay_s: f64,
}

impl DelayedTransferFunction {
    /// Response at the frequency `hz` (Hz).
    #[must_use]
    pub fn at(&self, hz: f64) -> Complex<f64> {
        let s = Complex::new(0.0, TAU * hz);
        held(hz, self.hold_s, self.delay_s) * self.rational.at(s)
    }

    /// True if all poles have a negative real part.
    #[must_use]
    pub fn is_stable(&self) -> bool {
        self.rational.slowest_pole().is_none_or(|real_part| real_part < 0.0)
    }

    /// Relative rms error over the targets.
    #[must_use]
    pub fn residual(&self, targets: &[Target]) -> f64 {
        relative(targets.iter().map(|t| (self.at(t.hz), t.value)))
    }
}

/// Rms of |model − measured|/|measured|.
pub fn relative(pairs: impl Iterator<Item = (Complex<f64>, Complex<f64>)>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (model, measured) in pairs {
        sum += ((model - measured) / measured).norm_sqr();
        count += 1.0;
    }
    if count > 0.0 { f64::sqrt(sum / count) } else { f64::INFINITY }
}

/// Fits a numerator and a denominator of these degrees, with hold and delay in s; `None` if the response doesn't
/// determine them.
#[must_use]
pub fn fit(
    targets: &[Target],
    degrees: (usize, usize),
    hold_s: f64,
    delay_s: f64,
) -> Option<DelayedTransferFunction> {
    let (m, n) = degrees;
    // Frequencies scaled to about 1 keep the powers of s at similar magnitudes.
    let scale = TAU * (targets.iter().map(|t| t.hz.ln()).sum::<f64>() / targets.len() as f64).exp();
    let mut before = vec![1.0];
    let mut best: Option<(f64, DelayedTransferFunction)> = None;
    for _ in 0..ROUNDS {
        let mut rows = DMatrix::zeros(2 * targets.len(), m + 1 + n);
        let mut right = DVector::zeros(2 * targets.len());
        for (k, target) in targets.iter().enumerate() {
            let s = Complex::new(0.0, TAU * target.hz / scale);
            let bare = target.value / held(target.hz, hold_s, delay_s);
            let weight = target.weight / value(&before, s).norm();
            for power in 0..=m {
                put(&mut rows, k, power, s.powu(power as u32) * weight);
            }
            for power in 1..=n {
                put(&mut rows, k, m + power, -bare * s.powu(power as u32) * weight);
            }
            right[2 * k] = bare.re * weight;
            right[2 * k + 1] = bare.im * weight;
        }
        let solved = rows.try_svd(true, true, f64::EPSILON, MAX_ITERATIONS)?.solve(&right, 1e-12).ok()?;
        let numerator: Vec<f64> = solved.iter().take(m + 1).copied().collect();
        let denominator: Vec<f64> = [1.0].into_iter().chain(solved.iter().skip(m + 1).copied()).collect();
        let back = |c: &[f64]| -> Vec<f64> {
            c.iter().enumerate().map(|(power, c)| c / scale.powi(power as i32)).collect()
        };
        let rational = TransferFunction { numerator: back(&numerator), denominator: back(&denominator) };
        let fitted = DelayedTransferFunction { rational, hold_s, delay_s };
        let cost: f64 = targets.iter().map(|t| (t.weight * (fitted.at(t.hz) - t.value).norm()).powi(2)).sum();
        if cost.is_finite() && best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, fitted));
        }
        before = denominator;
    }
    best.map(|(_, fitted)| fitted)
}

fn put(rows: &mut DMatrix<f64>, target: usize, column: usize, value: Complex<f64>) {
    rows[(2 * target, column)] = value.re;
    rows[(2 * target + 1, column)] = value.im;
}

/// Frequency response of a hold and a delay (s) at `hz` (Hz).
#[must_use]
pub fn held(hz: f64, hold_s: f64, delay_s: f64) -> Complex<f64> {
    let half = 0.5 * TAU * hz * hold_s;
    let sinc = if half.abs() < 1e-9 { 1.0 } else { half.sin() / half };
    Complex::from_polar(sinc, -half - TAU * hz * delay_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Smallest ratio of the residual with a wrong delay to the residual with the right delay.
    const WORSE: f64 = 1e3;
    const ROUNDING: f64 = 1e-12;

    /// Compares the fitted coefficients with those from which the response was computed.
    #[test]
    fn rational_function_with_hold_and_delay_is_recovered() {
        const TOLERANCE: f64 = 1e-6;
        let truth = DelayedTransferFunction {
            rational: TransferFunction {
                numerator: vec![1.0, 2e-3],
                denominator: vec![1.0, 0.025, 1.2e-4, 2e-7],
            },
            hold_s: 1e-3,
            delay_s: 6e-4,
        };
        assert!(truth.is_stable());
        let targets: Vec<Target> = (0..40)
            .map(|k| 0.5 * 1.18f64.powi(k))
            .map(|hz| Target { hz, value: truth.at(hz), weight: 1.0 })
            .collect();
        let found = fit(&targets, (1, 3), 1e-3, 6e-4).expect("determined");
        let (ours, theirs) = (&found.rational, &truth.rational);
        let pairs = ours.numerator.iter().zip(&theirs.numerator);
        for (f, t) in pairs.chain(ours.denominator.iter().zip(&theirs.denominator)) {
            assert!((f / t - 1.0).abs() < TOLERANCE, "{found:?}");
        }
        let late = fit(&targets, (1, 3), 1e-3, 2e-3).expect("determined");
        assert!(
            late.residual(&targets) > WORSE * found.residual(&targets).max(ROUNDING),
            "a wrong delay shows"
        );
    }
}
