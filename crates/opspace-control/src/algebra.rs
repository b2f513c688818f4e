//! Matrix-vector products with vectors of one element per joint, in place and without bounds checks.

use nalgebra::{DMatrix, Matrix6xX, Vector6};

/// Returns A x.
pub(crate) fn product(a: &Matrix6xX<f64>, x: &[f64]) -> Vector6<f64> {
    let (columns, _) = a.as_slice().as_chunks::<6>();
    columns.iter().zip(x).fold(Vector6::zeros(), |sum, (column, &x)| sum + Vector6::from(*column) * x)
}

/// Adds Aᵀ f to x.
pub(crate) fn add_transposed(a: &Matrix6xX<f64>, f: &Vector6<f64>, x: &mut [f64]) {
    let (columns, _) = a.as_slice().as_chunks::<6>();
    for (x, column) in x.iter_mut().zip(columns) {
        *x += Vector6::from(*column).dot(f);
    }
}

/// Writes A x into `out`, for a square A.
pub(crate) fn multiply(a: &DMatrix<f64>, x: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    for (column, &x) in a.as_slice().chunks_exact(x.len()).zip(x) {
        out.iter_mut().zip(column).for_each(|(sum, a)| *sum += a * x);
    }
}

/// Returns the dot product of a and b.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
