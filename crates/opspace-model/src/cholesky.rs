//! The mass matrix factored, and what follows without its inverse.
//!
//! `M = U Uᵀ` with U upper triangular, from the tips to the base: then U has zeros wherever neither of two joints
//! carries the other, as M has (RBDA §6.5; there `M = Lᵀ L` with L = Uᵀ). In Pinocchio `cholesky::decompose`,
//! `cholesky::solve` and `computeMinverse`.
//!
//! A joint's carriers are numbered in a few unbroken rows: one in a chain, one more at each branching. All loops
//! run over such rows, so that a tree costs only what isn't zero and a chain costs no more for it.

use crate::data::Data;
use crate::model::Model;
use crate::real::Real;
use nalgebra::{DMatrix, Matrix6xX, SimdBool};
use std::ops::Range;

/// U of M = U Uᵀ. The identity until [updated](Self::update).
#[derive(Clone, Debug)]
pub struct MassMatrixFactor<T = f64> {
    /// Column k holds rows 0 to k; zero where M is.
    upper: DMatrix<T>,
    /// 1/U_kk.
    reciprocal: Vec<T>,
    /// U⁻¹, of the same pattern. Scratch.
    inverse: DMatrix<T>,
    /// For each joint the first of the unbroken row of its carriers that ends with it, and the joint that carries
    /// that first one.
    rows: Vec<(usize, Option<usize>)>,
}

/// A joint and all that carry it, as unbroken rows from it inwards.
fn carriers(rows: &[(usize, Option<usize>)], last: Option<usize>) -> impl Iterator<Item = Range<usize>> + '_ {
    let mut last = last;
    std::iter::from_fn(move || {
        let end = last?;
        let (first, next) = rows[end];
        last = next;
        Some(first..end + 1)
    })
}

impl<T: Real> MassMatrixFactor<T> {
    /// Of the identity, with the sparsity of a robot's mass matrix.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let n = model.n();
        let mut rows: Vec<(usize, Option<usize>)> = Vec::with_capacity(n);
        for joint in 0..n {
            // Folded joints may couple any two: as if each carried the next.
            let carrier = if model.is_folded() { joint.checked_sub(1) } else { model.bodies[joint].parent };
            rows.push(match carrier {
                Some(c) if c + 1 == joint => rows[c],
                other => (joint, other),
            });
        }
        let upper = DMatrix::identity(n, n);
        Self { inverse: upper.clone(), upper, reciprocal: vec![T::one(); n], rows }
    }

    /// Factors a mass matrix of the model's pattern (n × n, kg m²).
    ///
    /// Returns `false`, with the factor half done, if a pivot isn't positive: it isn't positive definite.
    ///
    /// # Panics
    /// If it isn't n × n.
    #[must_use]
    pub fn update(&mut self, mass_matrix: &DMatrix<T>) -> bool {
        let n = self.reciprocal.len();
        self.upper.copy_from(mass_matrix);
        for k in (0..n).rev() {
            let pivot = self.upper[(k, k)];
            if !pivot.simd_gt(T::zero()).all() {
                return false;
            }
            let root = pivot.simd_sqrt();
            let reciprocal = T::one() / root;
            self.reciprocal[k] = reciprocal;
            // Columns left of k, and column k itself.
            let (left, right) = self.upper.as_mut_slice().split_at_mut(k * n);
            let column = &mut right[..=k];
            column[k] = root;
            let carrier = if self.rows[k].0 == k { self.rows[k].1 } else { Some(k - 1) };
            for row in carriers(&self.rows, carrier) {
                column[row].iter_mut().for_each(|x| *x *= reciprocal);
            }
            for row in carriers(&self.rows, carrier) {
                for i in row {
                    let factor = column[i];
                    for inner in carriers(&self.rows, Some(i)) {
                        let target = &mut left[i * n..][inner.clone()];
                        target.iter_mut().zip(&column[inner]).for_each(|(t, &c)| *t -= c * factor);
                    }
                }
            }
        }
        true
    }

    /// As the factor of the identity.
    pub fn set_identity(&mut self) {
        self.upper.fill_with_identity();
        self.reciprocal.fill(T::one());
    }

    /// x of M x = b, in place of b.
    ///
    /// # Panics
    /// If `x` is shorter than n.
    pub fn solve(&self, x: &mut [T]) {
        self.solve_upper(x);
        self.solve_transposed(x);
    }

    /// y of U y = b, in place of b.
    fn solve_upper(&self, x: &mut [T]) {
        let n = self.reciprocal.len();
        for k in (0..n).rev() {
            let y = x[k] * self.reciprocal[k];
            for row in carriers(&self.rows, Some(k)) {
                x[row.clone()].iter_mut().zip(&self.column(k)[row]).for_each(|(x, &u)| *x -= u * y);
            }
            x[k] = y;
        }
    }

    /// x of Uᵀ x = y, in place of y.
    fn solve_transposed(&self, x: &mut [T]) {
        for k in 0..self.reciprocal.len() {
            let mut sum = x[k];
            for row in carriers(&self.rows, self.carrier(k)) {
                x[row.clone()].iter().zip(&self.column(k)[row]).for_each(|(&x, &u)| sum -= u * x);
            }
            x[k] = sum * self.reciprocal[k];
        }
    }

    /// J U⁻ᵀ in place of J (6 × n): the half of J M⁻¹ Jᵀ.
    ///
    /// # Panics
    /// If `jacobian` doesn't have n columns.
    pub fn half_solve(&self, jacobian: &mut Matrix6xX<T>) {
        let n = self.reciprocal.len();
        assert_eq!(jacobian.ncols(), n, "one Jacobian column a joint");
        let (columns, _) = jacobian.as_mut_slice().as_chunks_mut::<6>();
        for k in (0..n).rev() {
            // Joints that don't carry the frame stay out of it.
            if columns[k] == [T::zero(); 6] {
                continue;
            }
            let y = columns[k].map(|x| x * self.reciprocal[k]);
            columns[k] = y;
            for row in carriers(&self.rows, self.carrier(k)) {
                let factors = &self.column(k)[row.clone()];
                columns[row].iter_mut().zip(factors).for_each(|(x, &u)| subtract(x, &y, u));
            }
        }
    }

    /// Y U⁻¹ in place of Y (6 × n): from [`half_solve`](Self::half_solve) on to J M⁻¹.
    ///
    /// # Panics
    /// If `jacobian` doesn't have n columns.
    pub fn finish_solve(&self, half: &mut Matrix6xX<T>) {
        let n = self.reciprocal.len();
        assert_eq!(half.ncols(), n, "one Jacobian column a joint");
        let (columns, _) = half.as_mut_slice().as_chunks_mut::<6>();
        for k in 0..n {
            let mut sum = columns[k];
            for row in carriers(&self.rows, self.carrier(k)) {
                let factors = &self.column(k)[row.clone()];
                columns[row].iter().zip(factors).for_each(|(x, &u)| subtract(&mut sum, x, u));
            }
            columns[k] = sum.map(|x| x * self.reciprocal[k]);
        }
    }

    /// M⁻¹ (n × n).
    ///
    /// # Panics
    /// If `out` isn't n × n.
    pub fn inverse(&mut self, out: &mut DMatrix<T>) {
        let n = self.reciprocal.len();
        assert_eq!(out.shape(), (n, n), "n rows and n columns");
        self.invert_upper();
        for i in 0..n {
            for j in 0..=i {
                // (U⁻¹)ᵀ U⁻¹: what carries both.
                let mut sum = T::zero();
                for row in carriers(&self.rows, Some(j)) {
                    let (a, b) = (
                        &self.inverse.as_slice()[i * n..][row.clone()],
                        &self.inverse.as_slice()[j * n..][row],
                    );
                    a.iter().zip(b).for_each(|(&a, &b)| sum += a * b);
                }
                out[(i, j)] = sum;
                out[(j, i)] = sum;
            }
        }
    }

    /// U⁻¹, column by column: column k is U⁻¹ e_k.
    fn invert_upper(&mut self) {
        let n = self.reciprocal.len();
        for k in 0..n {
            let Self { upper, reciprocal, inverse, rows } = self;
            let column = &mut inverse.as_mut_slice()[k * n..][..=k];
            column.fill(T::zero());
            column[k] = T::one();
            for outer in carriers(rows, Some(k)) {
                for i in outer.rev() {
                    let y = column[i] * reciprocal[i];
                    let u = &upper.as_slice()[i * n..][..=i];
                    for row in carriers(rows, Some(i)) {
                        column[row.clone()].iter_mut().zip(&u[row]).for_each(|(x, &u)| *x -= u * y);
                    }
                    column[i] = y;
                }
            }
        }
    }

    /// The joint that carries joint `k`.
    #[inline]
    fn carrier(&self, k: usize) -> Option<usize> {
        let (first, carrier) = self.rows[k];
        if first == k { carrier } else { Some(k - 1) }
    }

    /// Rows 0 to k of column k of U.
    #[inline]
    fn column(&self, k: usize) -> &[T] {
        &self.upper.as_slice()[k * self.reciprocal.len()..][..=k]
    }
}

/// x ← x − y u.
#[inline]
fn subtract<T: Real>(x: &mut [T; 6], y: &[T; 6], u: T) {
    for (x, &y) in x.iter_mut().zip(y) {
        *x -= y * u;
    }
}

/// Factors [`Data::mass_matrix`] into [`Data::mass_matrix_factor`]. Needs [`crba`](crate::crba()).
///
/// Returns `false` if it isn't positive definite: see [`MassMatrixFactor::update`].
#[must_use]
pub fn cholesky<T: Real>(data: &mut Data<T>) -> bool {
    data.mass_matrix_factor.update(&data.mass_matrix)
}

/// M⁻¹ into [`Data::mass_matrix_inverse`]. Needs [`cholesky`]. What is wanted is seldom the inverse:
/// [`MassMatrixFactor::solve`] gives M⁻¹ x for less.
pub fn mass_matrix_inverse<T: Real>(data: &mut Data<T>) {
    data.mass_matrix_factor.inverse(&mut data.mass_matrix_inverse);
}
