//! Inverse of a task's Λ⁻¹ without its spectrum, as far as it is certain that at most one direction is near singular.
//!
//! The eigenvectors of a 6 × 6 matrix take several times as long as its inverse, and near a singular pose they are needed
//! for one direction: that of the smallest eigenvalue λ with its vector v, by inverse iteration. All other directions are
//! inverted together, by (A + σ v vᵀ)⁻¹ with a σ that moves λ away from zero. Bounds on eigenvalues prove that no other one
//! is small; without this proof, the caller decomposes A.

use nalgebra::{Matrix6, Vector6};

/// Inverse of a symmetric matrix in the directions whose eigenvalues are certainly large enough.
pub(crate) enum PartialInverse {
    /// No eigenvalue is too small: the inverse.
    Whole(Matrix6<f64>),
    /// One eigenvalue may be too small.
    ButOne {
        /// Inverse in all directions but `vector`, in which it is zero.
        rest: Matrix6<f64>,
        /// The smallest eigenvalue.
        value: f64,
        /// Its eigenvector.
        vector: Vector6<f64>,
    },
    /// Nothing is certain.
    Unknown,
}

/// Largest number of inverse iterations. The error falls by the ratio of the two smallest eigenvalues with each.
const MAX_ITERATIONS: usize = 10;

/// Squared change of the eigenvector in an iteration at which it is accurate to rounding: the next change is smaller by the
/// ratio of the eigenvalues, which is below [`RATIO`].
const CONVERGED: f64 = 1e-28;

/// Ratio of the norm of all other eigenvalues of the inverse to the largest one above which the iteration would be slow.
const RATIO: f64 = 0.5;

/// Inverts the first `rows` rows of `a`, which belong to the task; the others have larger eigenvalues and are not coupled to
/// them, and are of no use in the inverse. An eigenvalue is too small if its inverse is above `largest_inverse`. `shift` is
/// an upper bound of the eigenvalues of the task's block.
pub(crate) fn partial_inverse(
    a: &Matrix6<f64>,
    rows: usize,
    shift: f64,
    largest_inverse: f64,
) -> PartialInverse {
    // Every eigenvalue is too small for damped least squares.
    let inverse = if largest_inverse > 0.0 { positive_inverse(a, rows) } else { None };
    let Some(inverse) = inverse else { return PartialInverse::Unknown };
    // The norm of A⁻¹ is at least its largest eigenvalue. Unlike the trace, it is also a bound if rounding makes an
    // eigenvalue near zero negative.
    let (of_inverse, largest_square) = (square_norm(&inverse), largest_inverse * largest_inverse);
    if of_inverse <= largest_square {
        return PartialInverse::Whole(inverse);
    }
    let Some(vector) = smallest_direction(&inverse, rows, of_inverse) else {
        return PartialInverse::Unknown;
    };
    // Exactly zero in the other rows, as they do not couple.
    let value = vector.dot(&(a * vector));
    let square = vector * vector.transpose();
    let Some(mut rest) = positive_inverse(&(a + square * shift), rows) else {
        return PartialInverse::Unknown;
    };
    rest -= square / (value + shift);
    if square_norm(&rest) <= largest_square {
        PartialInverse::ButOne { rest, value, vector }
    } else {
        PartialInverse::Unknown
    }
}

/// Returns the eigenvector of the largest eigenvalue of `inverse`; `None` if another one is not much smaller.
fn smallest_direction(inverse: &Matrix6<f64>, rows: usize, square_norm: f64) -> Option<Vector6<f64>> {
    let largest = (0..rows).max_by(|&a, &b| inverse[(a, a)].total_cmp(&inverse[(b, b)]))?;
    let mut vector = inverse.column(largest).normalize();
    for _ in 0..MAX_ITERATIONS {
        let next = inverse * vector;
        let eigenvalue = next.norm();
        if square_norm > (1.0 + RATIO * RATIO) * eigenvalue * eigenvalue {
            return None;
        }
        let next = next / eigenvalue;
        let change = (next - vector).norm_squared();
        vector = next;
        if change <= CONVERGED {
            return Some(vector);
        }
    }
    None
}

/// Sum of the squares of all entries, which is that of the eigenvalues.
fn square_norm(a: &Matrix6<f64>) -> f64 {
    // Six sums at a time.
    let squares: Vector6<f64> = a.column_iter().map(|column| column.component_mul(&column)).sum();
    squares.sum()
}

/// Returns the inverse of the first `rows` rows of a symmetric matrix; `None` if a pivot shows that the matrix is not
/// positive definite. The other rows, which are not coupled to them, are zero or inverted too.
fn positive_inverse(a: &Matrix6<f64>, rows: usize) -> Option<Matrix6<f64>> {
    // Positions alone are half the work.
    if rows <= 3 { inverse_of_first::<3>(a) } else { inverse_of_first::<6>(a) }
}

/// Inverts the first `N` rows by Gauss-Jordan elimination without pivoting, which is stable for positive definite matrices.
fn inverse_of_first<const N: usize>(a: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let mut swept = *a;
    for k in 0..N {
        let pivot = swept[(k, k)];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let reciprocal = 1.0 / pivot;
        let mut column = swept.column(k).into_owned();
        column[k] = 0.0;
        let scaled = column * reciprocal;
        for c in 0..N {
            let factor = swept[(k, c)];
            let mut target = swept.column_mut(c);
            target -= scaled * factor;
            target[k] = factor * reciprocal;
        }
        swept.set_column(k, &-scaled);
        swept[(k, k)] = reciprocal;
    }
    for r in N..6 {
        swept[(r, r)] = 0.0;
    }
    Some(swept)
}
