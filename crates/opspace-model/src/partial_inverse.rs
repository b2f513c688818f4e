//! Inverse of a task's Λ⁻¹ without its spectrum, as far as it is certain that at most one direction is near singular.
//!
//! The eigenvectors of a 6 × 6 matrix take several times as long as its inverse, and near a singular pose they are needed
//! for one direction: that of the smallest eigenvalue λ with its vector v, by inverse iteration. All other directions are
//! inverted together, by (A + σ v vᵀ)⁻¹ with a σ that moves λ away from zero. Bounds on eigenvalues prove that no other one
//! is small; without this proof, the caller decomposes A.

use nalgebra::{Matrix6, Vector6};

/// Directions in which the inverse of a symmetric matrix is certain.
pub(crate) enum PartialInverse {
    /// All: no eigenvalue is too small.
    Whole,
    /// All but one, in which the inverse is zero: its eigenvalue may be too small.
    ButOne {
        /// The smallest eigenvalue.
        value: f64,
        /// Its eigenvector.
        vector: Vector6<f64>,
    },
    /// None.
    Unknown,
}

/// Largest number of inverse iterations. The error falls by the ratio of the two smallest eigenvalues with each.
const MAX_ITERATIONS: usize = 10;

/// Squared change of the eigenvector in an iteration at which it is accurate to rounding: the next change is smaller by the
/// ratio of the eigenvalues, which is below [`RATIO`].
const CONVERGED: f64 = 1e-28;

/// Ratio of the norm of all other eigenvalues of the inverse to the largest one above which the iteration would be slow.
const RATIO: f64 = 0.5;

/// Writes the inverse of the first `rows` rows of `a`, which belong to the task, into `inverse`, as far as it is certain. The
/// other rows of `a` have larger eigenvalues and are not coupled to them; those of `inverse` are of no use. An eigenvalue is
/// too small if its inverse is above `largest_inverse`. `shift` is an upper bound of the eigenvalues of the task's block.
pub(crate) fn partial_inverse(
    a: &Matrix6<f64>,
    rows: usize,
    shift: f64,
    largest_inverse: f64,
    inverse: &mut Matrix6<f64>,
) -> PartialInverse {
    // Every eigenvalue is too small for damped least squares.
    if largest_inverse <= 0.0 {
        return PartialInverse::Unknown;
    }
    inverse.copy_from(a);
    if !invert_positive(inverse, rows) {
        return PartialInverse::Unknown;
    }
    // The norm of A⁻¹ is at least its largest eigenvalue. Unlike the trace, it is also a bound if rounding makes an
    // eigenvalue near zero negative.
    let (of_inverse, largest_square) = (square_norm(inverse), largest_inverse * largest_inverse);
    if of_inverse <= largest_square {
        return PartialInverse::Whole;
    }
    let Some(vector) = smallest_direction(inverse, rows, of_inverse) else {
        return PartialInverse::Unknown;
    };
    // Exactly zero in the other rows, as they do not couple.
    let value = vector.dot(&(a * vector));
    let square = vector * vector.transpose();
    *inverse = a + square * shift;
    if !invert_positive(inverse, rows) {
        return PartialInverse::Unknown;
    }
    *inverse -= square / (value + shift);
    if square_norm(inverse) <= largest_square {
        PartialInverse::ButOne { value, vector }
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

/// Replaces the first `rows` rows of a symmetric matrix by their inverse, to which the others are not coupled, and returns
/// true; false if a pivot shows that the matrix is not positive definite. The other rows become zero or are inverted too.
fn invert_positive(a: &mut Matrix6<f64>, rows: usize) -> bool {
    // Positions alone are half the work.
    if rows <= 3 { invert_first::<3>(a) } else { invert_first::<6>(a) }
}

/// Inverts the first `N` rows by Gauss-Jordan elimination without pivoting, which is stable for positive definite matrices.
fn invert_first<const N: usize>(a: &mut Matrix6<f64>) -> bool {
    for k in 0..N {
        let pivot = a[(k, k)];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        let reciprocal = 1.0 / pivot;
        let mut column = a.column(k).into_owned();
        column[k] = 0.0;
        let scaled = column * reciprocal;
        for c in 0..N {
            let factor = a[(k, c)];
            let mut target = a.column_mut(c);
            target -= scaled * factor;
            target[k] = factor * reciprocal;
        }
        a.set_column(k, &-scaled);
        a[(k, k)] = reciprocal;
    }
    for r in N..6 {
        a[(r, r)] = 0.0;
    }
    true
}
