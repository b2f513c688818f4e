//! Polynomials given by their coefficients, in ascending order from the constant.

use nalgebra::{Complex, DMatrix, Schur};

/// Value of a polynomial.
#[must_use]
pub fn value(coefficients: &[f64], at: Complex<f64>) -> Complex<f64> {
    coefficients.iter().rev().fold(Complex::new(0.0, 0.0), |sum, &c| sum * at + c)
}

/// Product of two polynomials.
#[must_use]
pub fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, a) in a.iter().enumerate() {
        for (j, b) in b.iter().enumerate() {
            product[i + j] += a * b;
        }
    }
    product
}

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
pub(crate) const MAX_ITERATIONS: usize = 1000;

/// Roots of a polynomial: eigenvalues of its companion matrix. NaN if the coefficients differ so much in size that it is
/// not finite.
#[must_use]
pub fn roots(coefficients: &[f64]) -> Vec<Complex<f64>> {
    let degree = coefficients.iter().rposition(|c| *c != 0.0).unwrap_or(0);
    if degree == 0 {
        return Vec::new();
    }
    let mut companion = DMatrix::zeros(degree, degree);
    for k in 0..degree {
        companion[(k, degree - 1)] = -coefficients[k] / coefficients[degree];
        if k > 0 {
            companion[(k, k - 1)] = 1.0;
        }
    }
    match Schur::try_new(companion, f64::EPSILON, MAX_ITERATIONS) {
        Some(decomposed) => decomposed.complex_eigenvalues().iter().copied().collect(),
        None => vec![Complex::new(f64::NAN, f64::NAN); degree],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tolerance of floating-point solutions.
    const EXACT: f64 = 1e-9;

    /// Checks the product's value at each of its roots, and that its roots are those of its factors.
    #[test]
    fn product_has_roots_of_both_factors() {
        let (a, b) = ([6.0, 5.0, 1.0], [4.0, 0.0, 1.0]);
        let both = product(&a, &b);
        assert_eq!(both, [24.0, 20.0, 10.0, 5.0, 1.0]);
        let found = roots(&both);
        assert_eq!(found.len(), 4);
        assert!(found.iter().all(|&root| value(&both, root).norm() < EXACT), "{found:?}");
        for root in [(-2.0, 0.0), (-3.0, 0.0), (0.0, 2.0), (0.0, -2.0)].map(|(re, im)| Complex::new(re, im)) {
            assert!(found.iter().any(|other| (other - root).norm() < EXACT), "{root} in {found:?}");
        }
        assert!(roots(&[3.0, 0.0]).is_empty() && roots(&[]).is_empty());
    }
}
