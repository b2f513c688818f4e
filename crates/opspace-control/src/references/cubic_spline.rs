//! Natural cubic splines: twice continuously differentiable, without curvature at both ends.
//!
//! ```text
//! h₋ M₋ + 2(h₋ + h) M + h M₊ = 6 ((y₊ − y)/h − (y − y₋)/h₋)        M: second derivatives, zero at both ends
//! ```

use crate::references::ramp::Quintic;

/// Returns the natural cubic spline through `values` at increasing `knots`: the polynomial of each interval in the
/// distance from its first knot.
pub(crate) fn natural_spline(knots: &[f64], values: &[f64]) -> Vec<Quintic> {
    let last = knots.len().saturating_sub(1);
    let h = |k: usize| knots[k + 1] - knots[k];
    let slope = |k: usize| (values[k + 1] - values[k]) / h(k);
    // Thomas' algorithm: the matrix is diagonally dominant.
    let mut upper = vec![0.0; knots.len()];
    let mut bends = vec![0.0; knots.len()];
    for k in 1..last {
        let pivot = 2.0 * (h(k - 1) + h(k)) - h(k - 1) * upper[k - 1];
        upper[k] = h(k) / pivot;
        bends[k] = (6.0 * (slope(k) - slope(k - 1)) - h(k - 1) * bends[k - 1]) / pivot;
    }
    for k in (1..last).rev() {
        bends[k] -= upper[k] * bends[k + 1];
    }
    (0..last)
        .map(|k| {
            let first = slope(k) - (2.0 * bends[k] + bends[k + 1]) * (h(k) / 6.0);
            let third = (bends[k + 1] - bends[k]) / h(k);
            Quintic { coefficients: [values[k], first, bends[k] / 2.0, third / 6.0, 0.0, 0.0] }
        })
        .collect()
}
