//! Factorization of the mass matrix and products with its inverse.
//!
//! `M = U D Uᵀ` with U upper triangular with a unit diagonal, computed from the tips to the base. U then has the
//! sparsity of M: entry (i, j) is zero unless one of the joints i and j is an ancestor of the other (RBDA §6.5; there
//! `M = Lᵀ D L` with L = Uᵀ). In Pinocchio `cholesky::decompose`, `cholesky::solve` and `computeMinverse`.
//!
//! The indices of the ancestors of a joint form a few contiguous ranges: one range in a chain, and one more for each
//! branching. All loops run over these ranges and therefore only over non-zero entries, without overhead for chains.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, cholesky, crba, forward_kinematics};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! forward_kinematics(&model, &mut data, &[0.3; 6]);
//! crba(&model, &mut data);
//! assert!(cholesky(&mut data), "M is positive definite");
//! let mut x = [1.0; 6];
//! data.mass_matrix_factor.solve(&mut x); // M⁻¹ x
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::data::Data;
use crate::model::Model;
use crate::real::Real;
use nalgebra::{DMatrix, Matrix6, Matrix6xX, SimdBool};
use std::ops::Range;

/// Factors U and D of M = U D Uᵀ. Before the first [`update`](Self::update) they are those of the identity.
#[derive(Clone, Debug)]
pub struct MassMatrixFactor<T = f64> {
    /// Column k contains rows 0 to k − 1 of U, which are zero where M is. Entries on and below the diagonal are not
    /// used.
    upper: DMatrix<T>,
    /// Reciprocals of the diagonal of D (n).
    reciprocal: Vec<T>,
    /// Intermediate values: rows of U⁻¹, one per column.
    inverse_rows: DMatrix<T>,
    /// Per joint: one more than the index of its last descendant (or its own index).
    ends: Vec<usize>,
    /// Per joint: the first joint of the contiguous range of ancestors that ends at this joint, and the parent of that
    /// first joint.
    rows: Vec<(usize, Option<usize>)>,
}

/// Returns joint `last` and its ancestors as contiguous ranges of indices, from `last` towards the base.
#[inline]
fn ancestor_ranges(
    rows: &[(usize, Option<usize>)],
    last: Option<usize>,
) -> impl Iterator<Item = Range<usize>> + '_ {
    let mut last = last;
    std::iter::from_fn(move || {
        let end = last?;
        let (first, next) = rows[end];
        last = next;
        Some(first..end + 1)
    })
}

/// Returns the parent of joint `k`.
#[inline]
fn parent(rows: &[(usize, Option<usize>)], k: usize) -> Option<usize> {
    let (first, parent) = rows[k];
    if first == k { parent } else { Some(k - 1) }
}

impl<T: Real> MassMatrixFactor<T> {
    /// Returns the factor of the identity, with the sparsity of the mass matrix of `model`.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let n = model.n();
        let mut rows: Vec<(usize, Option<usize>)> = Vec::with_capacity(n);
        for joint in 0..n {
            // Mimic constraints may couple any two joints. The matrix is then dense, as in a chain in which each joint
            // is the parent of the next.
            let above =
                if model.has_mimic_constraints() { joint.checked_sub(1) } else { model.bodies[joint].parent };
            rows.push(match above {
                Some(c) if c + 1 == joint => rows[c],
                other => (joint, other),
            });
        }
        let upper = DMatrix::identity(n, n);
        let mut ends: Vec<usize> = (1..=n).collect();
        for joint in (0..n).rev() {
            if let Some(c) = parent(&rows, joint) {
                ends[c] = ends[c].max(ends[joint]);
            }
        }
        Self { inverse_rows: upper.clone(), upper, reciprocal: vec![T::one(); n], ends, rows }
    }

    /// Factors a mass matrix (n × n, kg m²) with the sparsity of the model.
    ///
    /// Returns `false` and leaves the factor incomplete if a pivot is not positive (with lanes: any of them), because
    /// the matrix is then not positive definite.
    ///
    /// # Panics
    /// If the matrix is not n × n.
    #[must_use]
    pub fn update(&mut self, mass_matrix: &DMatrix<T>) -> bool {
        let n = self.reciprocal.len();
        assert_eq!(mass_matrix.shape(), (n, n), "n rows and n columns");
        self.upper.as_mut_slice().copy_from_slice(mass_matrix.as_slice());
        for k in (0..n).rev() {
            let parent = self.parent(k);
            // Columns to the left of k, and column k.
            let (left, right) = self.upper.as_mut_slice().split_at_mut(k * n);
            let (pivot, column) = (right[k], &mut right[..k]);
            if !pivot.simd_gt(T::zero()).all() {
                return false;
            }
            let reciprocal = T::one() / pivot;
            self.reciprocal[k] = reciprocal;
            // Rows are scaled in order from k towards the base: the remaining rows do not use the entries that are
            // already scaled.
            for row in ancestor_ranges(&self.rows, parent) {
                for i in row.rev() {
                    let factor = column[i] * reciprocal;
                    for inner in ancestor_ranges(&self.rows, Some(i)) {
                        let target = &mut left[i * n..][inner.clone()];
                        target.iter_mut().zip(&column[inner]).for_each(|(t, &c)| *t -= c * factor);
                    }
                    column[i] = factor;
                }
            }
        }
        true
    }

    /// Resets to the factor of the identity.
    pub fn set_identity(&mut self) {
        self.upper.fill_with_identity();
        self.reciprocal.fill(T::one());
    }

    /// Solves M x = b. `x` (n) contains b on entry and the solution on return.
    ///
    /// # Panics
    /// If `x` is shorter than n.
    pub fn solve(&self, x: &mut [T]) {
        let n = self.reciprocal.len();
        for k in (0..n).rev() {
            let y = x[k];
            for row in ancestor_ranges(&self.rows, self.parent(k)) {
                x[row.clone()].iter_mut().zip(&self.column(k)[row]).for_each(|(x, &u)| *x -= u * y);
            }
        }
        for k in 0..n {
            let mut sum = x[k] * self.reciprocal[k];
            for row in ancestor_ranges(&self.rows, self.parent(k)) {
                x[row.clone()].iter().zip(&self.column(k)[row]).for_each(|(&x, &u)| sum -= u * x);
            }
            x[k] = sum;
        }
    }

    /// Replaces X (n × n) by M⁻¹ X, for all columns at once.
    ///
    /// # Panics
    /// If `x` is not n × n.
    pub fn solve_matrix(&self, x: &mut DMatrix<T>) {
        let n = self.reciprocal.len();
        assert_eq!(x.shape(), (n, n), "n rows and n columns");
        x.transpose_mut();
        let rows = x.as_mut_slice();
        for k in (0..n).rev() {
            let (before, y) = rows.split_at_mut(k * n);
            for row in ancestor_ranges(&self.rows, self.parent(k)) {
                for i in row {
                    let u = self.upper[(i, k)];
                    before[i * n..][..n].iter_mut().zip(&y[..n]).for_each(|(x, &y)| *x -= y * u);
                }
            }
        }
        for k in 0..n {
            let (before, y) = rows.split_at_mut(k * n);
            y[..n].iter_mut().for_each(|y| *y *= self.reciprocal[k]);
            for row in ancestor_ranges(&self.rows, self.parent(k)) {
                for i in row {
                    let u = self.upper[(i, k)];
                    y[..n].iter_mut().zip(&before[i * n..][..n]).for_each(|(y, &x)| *y -= x * u);
                }
            }
        }
        x.transpose_mut();
    }

    /// Returns J M⁻¹ Jᵀ (6 × 6), the task acceleration per unit of task force. Replaces J (6 × n) by J U⁻ᵀ D⁻¹, the
    /// input of [`finish_solve`](Self::finish_solve).
    ///
    /// # Panics
    /// If `jacobian` does not have n columns.
    pub fn mobility(&self, jacobian: &mut Matrix6xX<T>) -> Matrix6<T> {
        let n = self.reciprocal.len();
        assert_eq!(jacobian.ncols(), n, "one Jacobian column a joint");
        let mut mobility = [[T::zero(); 6]; 6];
        let (columns, _) = jacobian.as_mut_slice().as_chunks_mut::<6>();
        for k in (0..n).rev() {
            let y = columns[k];
            // Joints that do not move the frame contribute nothing.
            if y == [T::zero(); 6] {
                continue;
            }
            for row in ancestor_ranges(&self.rows, self.parent(k)) {
                let factors = &self.column(k)[row.clone()];
                columns[row].iter_mut().zip(factors).for_each(|(x, &u)| subtract(x, &y, u));
            }
            let scaled = y.map(|x| x * self.reciprocal[k]);
            mobility.iter_mut().zip(y).for_each(|(column, y)| subtract(column, &scaled, -y));
            columns[k] = scaled;
        }
        Matrix6::from_fn(|r, c| mobility[c][r])
    }

    /// Replaces the result of [`mobility`](Self::mobility) (6 × n) by J M⁻¹.
    ///
    /// # Panics
    /// If `half` does not have n columns.
    pub fn finish_solve(&self, half: &mut Matrix6xX<T>) {
        let n = self.reciprocal.len();
        assert_eq!(half.ncols(), n, "one Jacobian column a joint");
        let (columns, _) = half.as_mut_slice().as_chunks_mut::<6>();
        for k in 0..n {
            let mut sum = columns[k];
            for row in ancestor_ranges(&self.rows, self.parent(k)) {
                let factors = &self.column(k)[row.clone()];
                columns[row].iter().zip(factors).for_each(|(x, &u)| subtract(&mut sum, x, u));
            }
            columns[k] = sum;
        }
    }

    /// Computes M⁻¹ (n × n) = Σ_k w_k w_kᵀ / D_k with w_k the k-th row of U⁻¹. Only the entries of w_k for joint k and
    /// its descendants are not zero; their indices are contiguous.
    ///
    /// # Panics
    /// If `out` is not n × n.
    pub fn inverse(&mut self, out: &mut DMatrix<T>) {
        let n = self.reciprocal.len();
        assert_eq!(out.shape(), (n, n), "n rows and n columns");
        let Self { upper, reciprocal, inverse_rows, ends, .. } = self;
        let upper = upper.as_slice();
        let out = out.as_mut_slice();
        out.fill(T::zero());
        for k in (0..n).rev() {
            // w_k = e_k − Σ U_kj w_j.
            let (w, beyond) = inverse_rows.as_mut_slice()[k * n..].split_at_mut(n);
            let subtree = k..ends[k];
            w[subtree.clone()].fill(T::zero());
            w[k] = T::one();
            for j in k + 1..ends[k] {
                let u = upper[j * n + k];
                let theirs = &beyond[(j - k - 1) * n..][j..ends[j]];
                w[j..ends[j]].iter_mut().zip(theirs).for_each(|(x, &y)| *x -= y * u);
            }
            let w = &w[subtree.clone()];
            for (c, &entry) in subtree.clone().zip(w) {
                let factor = entry * reciprocal[k];
                let column = &mut out[c * n..][subtree.clone()];
                column.iter_mut().zip(w).for_each(|(x, &y)| *x += y * factor);
            }
        }
    }

    /// Returns the parent of joint `k`.
    #[inline]
    fn parent(&self, k: usize) -> Option<usize> {
        parent(&self.rows, k)
    }

    /// Returns column k of U above the diagonal.
    #[inline]
    fn column(&self, k: usize) -> &[T] {
        &self.upper.as_slice()[k * self.reciprocal.len()..][..k]
    }
}

/// Subtracts y u from x.
#[inline]
fn subtract<T: Real>(x: &mut [T; 6], y: &[T; 6], u: T) {
    for (x, &y) in x.iter_mut().zip(y) {
        *x -= y * u;
    }
}

/// Factors [`Data::mass_matrix`] into [`Data::mass_matrix_factor`]. Needs [`crba`](crate::crba()).
///
/// Returns `false` if the mass matrix is not positive definite: see [`MassMatrixFactor::update`].
#[must_use]
pub fn cholesky<T: Real>(data: &mut Data<T>) -> bool {
    data.mass_matrix_factor.update(&data.mass_matrix)
}

/// Computes M⁻¹ into [`Data::mass_matrix_inverse`]. Needs [`cholesky`]. The inverse itself is seldom needed:
/// [`MassMatrixFactor::solve`] computes M⁻¹ x at lower cost.
pub fn mass_matrix_inverse<T: Real>(data: &mut Data<T>) {
    data.mass_matrix_factor.inverse(&mut data.mass_matrix_inverse);
}
