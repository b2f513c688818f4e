//! Small, dense, strictly convex quadratic programmes, and what may be wrong with one.
//!
//! Two solvers read them: [`ActiveSet`](crate::qp::active_set::ActiveSet), for the loop, and
//! [`InteriorPoint`](crate::qp::interior_point::InteriorPoint), an independent second opinion.

use nalgebra::{DMatrix, DVector};

/// A pivot of the Hessian's factor below this share of the diagonal is rounding: the Hessian is not positive
/// definite.
const PIVOT_SHARE: f64 = 16.0 * f64::EPSILON;

/// min ½ xᵀ H x + gᵀ x   subject to   l ≤ Cᵀ x ≤ u.
///
/// The arrays are as large as the largest programme that they are to hold; a programme of n variables and m
/// rows is in their leading blocks.
#[derive(Clone, Debug)]
pub struct QuadraticProgram {
    /// H, n × n, symmetric positive definite. Only its lower triangle is read.
    pub hessian: DMatrix<f64>,
    /// g, n.
    pub gradient: DVector<f64>,
    /// C, n × m: each row of the constraints is a column here, and so contiguous.
    pub rows: DMatrix<f64>,
    /// l, m: −∞ where there is no bound; equal to u for an equality.
    pub lower: DVector<f64>,
    /// u, m: ∞ where there is no bound.
    pub upper: DVector<f64>,
    variables: usize,
    constraints: usize,
}

/// Why a quadratic programme has no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QpError {
    /// No x meets the constraints.
    #[error("constraint {row} is inconsistent with the other constraints")]
    Infeasible {
        /// A row that contradicts itself or others.
        row: usize,
    },
    /// The Hessian is not positive definite.
    #[error("the Hessian is not positive definite")]
    NotConvex,
    /// A NaN or an infinity in the programme, or an overflow on the way.
    #[error("the problem data has a NaN or an infinity where a finite number is needed, or overflows")]
    NotFinite,
    /// The solver's bound on its iterations.
    #[error("the solver reached its iteration limit")]
    Iterations,
    /// Anything else, by name.
    #[error("the solver found no solution: {0}")]
    Unsolved(&'static str),
}

impl QuadraticProgram {
    /// All zero, with room for `variables` and `constraints`, all of them in use.
    #[must_use]
    pub fn new(variables: usize, constraints: usize) -> Self {
        Self {
            hessian: DMatrix::zeros(variables, variables),
            gradient: DVector::zeros(variables),
            rows: DMatrix::zeros(variables, constraints),
            lower: DVector::zeros(constraints),
            upper: DVector::zeros(constraints),
            variables,
            constraints,
        }
    }

    /// Takes the leading `variables` and `constraints` into use, with whatever numbers stand there.
    ///
    /// # Panics
    /// If there is no room for that many.
    pub fn resize(&mut self, variables: usize, constraints: usize) {
        assert!(
            variables <= self.gradient.len() && constraints <= self.lower.len(),
            "{variables} variables and {constraints} constraints exceed {} and {}",
            self.gradient.len(),
            self.lower.len()
        );
        (self.variables, self.constraints) = (variables, constraints);
    }

    /// n, the number of variables in use.
    #[must_use]
    pub fn variables(&self) -> usize {
        self.variables
    }

    /// m, the number of constraints in use.
    #[must_use]
    pub fn constraints(&self) -> usize {
        self.constraints
    }

    /// The coefficients of constraint `i`, n.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        let start = i * self.rows.nrows();
        &self.rows.as_slice()[start..start + self.variables]
    }

    /// Constraint `i`'s coefficients, to be set.
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        let start = i * self.rows.nrows();
        &mut self.rows.as_mut_slice()[start..start + self.variables]
    }

    /// Column `j` of H from the diagonal down, n − j.
    #[must_use]
    pub fn hessian_column(&self, j: usize) -> &[f64] {
        let start = j * self.hessian.nrows();
        &self.hessian.as_slice()[start + j..start + self.variables]
    }

    /// Adds H x to `sum`, both n.
    pub(crate) fn add_hessian_times(&self, x: &[f64], sum: &mut [f64]) {
        for j in 0..self.variables {
            let column = self.hessian_column(j);
            axpy(x[j], column, &mut sum[j..]);
            sum[j] += dot(&column[1..], &x[j + 1..]);
        }
    }

    /// Refuses, before any arithmetic, what no solver should see: arrays that don't fit one another, a NaN, an
    /// infinity that is not the absence of a bound, bounds that exclude each other.
    pub(crate) fn check(&self) -> Result<(), QpError> {
        let (n, m) = (self.variables, self.constraints);
        let fits = self.hessian.nrows() >= n
            && self.hessian.ncols() >= n
            && self.gradient.len() >= n
            && self.rows.nrows() >= n
            && self.rows.ncols() >= m
            && self.lower.len() >= m
            && self.upper.len() >= m;
        if !fits {
            return Err(QpError::Unsolved("an array is smaller than the problem"));
        }
        let finite = (0..n).all(|j| all_finite(self.hessian_column(j)))
            && all_finite(&self.gradient.as_slice()[..n])
            && (0..m).all(|i| all_finite(self.row(i)));
        let bounds = || self.lower.iter().zip(self.upper.iter()).take(m);
        if !finite || bounds().any(|(lower, upper)| lower.is_nan() || upper.is_nan()) {
            return Err(QpError::NotFinite);
        }
        let excluded = |(lower, upper): (&f64, &f64)| {
            lower > upper || *lower == f64::INFINITY || *upper == f64::NEG_INFINITY
        };
        match bounds().position(excluded) {
            Some(row) => Err(QpError::Infeasible { row }),
            None => Ok(()),
        }
    }

    /// L of H = L Lᵀ, into the lower triangle of `factor` (n × n by columns, its diagonal inverted): column by
    /// column, each less its share of those before.
    pub(crate) fn cholesky(&self, factor: &mut [f64]) -> Result<(), QpError> {
        let n = self.variables;
        for k in 0..n {
            let (done, rest) = factor.split_at_mut(k * n);
            let column = &mut rest[k..n];
            column.copy_from_slice(self.hessian_column(k));
            let diagonal = column[0];
            for before in done.chunks_exact(n) {
                axpy(-before[k], &before[k..], column);
            }
            let pivot = column[0];
            if pivot.is_nan() || pivot <= PIVOT_SHARE * diagonal.abs() {
                return Err(QpError::NotConvex);
            }
            let inverse = 1.0 / pivot.sqrt();
            column[0] = inverse;
            column[1..].iter_mut().for_each(|x| *x *= inverse);
        }
        Ok(())
    }
}

/// aᵀ b.
#[inline]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// y + a x in place of y.
#[inline]
pub(crate) fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}

/// Without an early exit, so that the compiler can look at several at once.
pub(crate) fn all_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |all, x| all & x.is_finite())
}
