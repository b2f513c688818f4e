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
#[non_exhaustive]
pub struct Minimum {
    /// Parameters at the minimum.
    pub x: Vec<f64>,
    /// Sum of squared residuals.
    pub cost: f64,
    residuals: DVector<f64>,
    jacobian: DMatrix<f64>,
}

impl Minimum {
    /// Returns the standard deviation of each parameter, from the residuals: the larger of that of independent residuals
    /// of equal variance, and of residuals that are correlated with those at neighbouring places (W. Newey, K. West, *A
    /// simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix*, Econometrica
    /// 55(3), 1987). `places` has the places of the first residuals; the others are those of priors, independent and with a
    /// variance of one. The correlation ends at the distance `width`. Errors of a model are correlated, and move the parameters more than
    /// independent noise of the same size. `None` if the residuals do not determine the parameters.
    #[must_use]
    pub fn deviations(&self, places: &[f64], width: f64) -> Option<Vec<f64>> {
        let (n, p) = self.jacobian.shape();
        let normal = self.jacobian.tr_mul(&self.jacobian);
        let decomposed = SVD::try_new_unordered(normal, true, true, 5.0 * f64::EPSILON, MAX_ITERATIONS)?;
        let bread = decomposed.pseudo_inverse(1e-300).ok()?;
        let measured = places.len().min(n);
        let spread = measured as f64 / measured.saturating_sub(p).max(1) as f64;
        let square = self.residuals.rows(0, measured).norm_squared() / measured.max(1) as f64 * spread;
        let scores: Vec<DVector<f64>> =
            (0..measured).map(|k| self.jacobian.row(k).transpose() * self.residuals[k]).collect();
        let weight = |k: usize, l: usize| 1.0 - (places[k] - places[l]).abs() / width;
        let mut meat = DMatrix::zeros(p, p);
        for (k, one) in scores.iter().enumerate() {
            for (l, other) in scores.iter().enumerate().filter(|(l, _)| weight(k, *l) > 0.0) {
                meat.ger(weight(k, l) * spread, one, other, 1.0);
            }
        }
        let rows = self.jacobian.rows(0, measured);
        let others = self.jacobian.rows(measured, n - measured);
        let priors = others.tr_mul(&others);
        let independent = &bread * (rows.tr_mul(&rows) * square + &priors) * &bread;
        let correlated = &bread * (meat + priors) * &bread;
        let deviation = |i: usize| f64::max(independent[(i, i)], correlated[(i, i)]).max(0.0).sqrt();
        Some((0..p).map(deviation).collect())
    }

    /// Residuals at the minimum.
    #[must_use]
    pub fn residuals(&self) -> &[f64] {
        self.residuals.as_slice()
    }

    /// Rms of the residuals.
    #[must_use]
    pub fn rms(&self) -> f64 {
        (self.cost / self.residuals.len().max(1) as f64).sqrt()
    }
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
    Some(Minimum { x, cost: r.norm_squared(), residuals: r, jacobian })
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
    /// Checks that a parameter that only a prior determines has the deviation of the prior, however small the residuals of
    /// the measurements are.
    #[test]
    fn parameter_without_measurement_has_deviation_of_its_prior() {
        const TOLERANCE: f64 = 0.02;
        const WITHIN: f64 = 2.3;
        const NOISE: f64 = 1e-3;
        let places: Vec<f64> = (0..20).map(f64::from).collect();
        let noise = |k: f64| NOISE * (7.0 * k).sin();
        let residuals = |x: &[f64]| {
            let measured = (0..20).map(|k| x[0] - noise(f64::from(k)));
            Some(measured.chain([x[1] / WITHIN]).collect())
        };
        let found = minimise(&[0.5, 0.1], residuals).expect("finite");
        let deviations = found.deviations(&places, 0.8).expect("determined");
        assert!((deviations[1] / WITHIN - 1.0).abs() < TOLERANCE, "{deviations:?}");
        assert!(deviations[0] < NOISE, "{deviations:?}");
    }
}
