//! The Cholesky factor of the mass matrix, in place and without allocation.

use nalgebra::DMatrix;

/// L of a = L Lᵀ into the lower triangle of `factor`; only the lower triangle of `a` is read.
///
/// Returns `false`, with `factor` half done, if a pivot isn't positive: `a` isn't positive definite.
///
/// # Panics
/// If the two are not square of one size.
pub fn cholesky(a: &DMatrix<f64>, factor: &mut DMatrix<f64>) -> bool {
    let n = a.nrows();
    assert!(a.is_square() && factor.shape() == a.shape());
    for j in 0..n {
        for i in j..n {
            let mut sum = a[(i, j)];
            for k in 0..j {
                sum -= factor[(i, k)] * factor[(j, k)];
            }
            if i > j {
                factor[(i, j)] = sum / factor[(j, j)];
            } else if sum > 0.0 {
                factor[(j, j)] = sum.sqrt();
            } else {
                return false;
            }
        }
    }
    true
}

/// x of L Lᵀ x = b, in place of b. Only the lower triangle of `factor` is read.
///
/// # Panics
/// If `x` is shorter than `factor`.
pub fn cholesky_solve(factor: &DMatrix<f64>, x: &mut [f64]) {
    let n = factor.nrows();
    for i in 0..n {
        for k in 0..i {
            x[i] -= factor[(i, k)] * x[k];
        }
        x[i] /= factor[(i, i)];
    }
    for i in (0..n).rev() {
        for k in i + 1..n {
            x[i] -= factor[(k, i)] * x[k];
        }
        x[i] /= factor[(i, i)];
    }
}
