//! Nonlinear least squares by the Levenberg-Marquardt method with finite differences, for a few parameters.

use nalgebra::{DMatrix, DVector, SVD};

const STEPS: usize = 60;
const DIFFERENCE: f64 = 1e-6;
/// Largest number of iterations of a decomposition; some ten are enough.
const MAX_ITERATIONS: usize = 1000;
/// Relative change of the cost at which the iteration ends.
const GAIN: f64 = 1e-9;

/// Minimum of the sum of squared residuals.
#[derive(Clone, Debug)]
pub struct Minimum {
    /// Parameters at the minimum.
    pub x: Vec<f64>,
    /// Sum of squared residuals.
    pub cost: f64,
    /// Standard deviation of each parameter, if the residuals are independent noise of equal variance.
    pub deviation: Vec<f64>,
}

/// Minimizes |r(x)|² from `start`; `None` if the residuals at `start` are not finite.
pub fn minimise(start: &[f64], residuals: impl Fn(&[f64]) -> Option<Vec<f64>>) -> Option<Minimum> {
    let finite = |x: &[f64]| residuals(x).filter(|r| r.iter().all(|v| v.is_finite()));
    let mut x = start.to_vec();
    let mut r = DVector::from_vec(finite(&x)?);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        let jacobian = jacobian(&x, &r, &finite)?;
        let normal = jacobian.tr_mul(&jacobian);
        let gradient = jacobian.tr_mul(&r);
        let before = r.norm_squared();
        let mut gained = false;
        while damping < 1e9 {
            let mut damped = normal.clone();
            for i in 0..x.len() {
                damped[(i, i)] += damping * normal[(i, i)].max(1e-12);
            }
            let step = damped.lu().solve(&gradient)?;
            let next: Vec<f64> = x.iter().zip(step.iter()).map(|(x, s)| x - s).collect();
            if let Some(next_r) = finite(&next).map(DVector::from_vec)
                && next_r.norm_squared() < before
            {
                (x, r) = (next, next_r);
                damping = (damping / 5.0).max(1e-12);
                gained = true;
                break;
            }
            damping *= 4.0;
        }
        if !gained || before - r.norm_squared() < GAIN * before {
            break;
        }
    }
    let jacobian = jacobian(&x, &r, &finite)?;
    let cost = r.norm_squared();
    let degrees = r.len().saturating_sub(x.len()).max(1) as f64;
    let normal = jacobian.tr_mul(&jacobian);
    let decomposed = SVD::try_new_unordered(normal, true, true, 5.0 * f64::EPSILON, MAX_ITERATIONS)?;
    let covariance = decomposed.pseudo_inverse(1e-300).ok()?;
    let deviation = covariance.diagonal().iter().map(|v| (v.max(0.0) * cost / degrees).sqrt()).collect();
    Some(Minimum { x, cost, deviation })
}

fn jacobian(
    x: &[f64],
    r: &DVector<f64>,
    residuals: &impl Fn(&[f64]) -> Option<Vec<f64>>,
) -> Option<DMatrix<f64>> {
    let mut jacobian = DMatrix::zeros(r.len(), x.len());
    for i in 0..x.len() {
        let mut beside = x.to_vec();
        beside[i] += DIFFERENCE;
        let moved = DVector::from_vec(residuals(&beside)?);
        jacobian.set_column(i, &((moved - r) / DIFFERENCE));
    }
    Some(jacobian)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares the minimum with the parameters from which exact samples of a decaying exponential were computed.
    #[test]
    fn exponential_parameters_are_recovered() {
        const TOLERANCE: f64 = 1e-6;
        let model = |x: &[f64], t: f64| x[0] * (-x[1] * t).exp();
        let truth = [3.0, 0.7];
        let residuals = |x: &[f64]| {
            Some((0..20).map(|k| f64::from(k) * 0.2).map(|t| model(x, t) - model(&truth, t)).collect())
        };
        let found = minimise(&[1.0, 0.1], residuals).expect("finite");
        assert!(found.x.iter().zip(truth).all(|(x, t)| (x - t).abs() < TOLERANCE), "{found:?}");
    }
}
