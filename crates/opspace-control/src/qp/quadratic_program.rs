//! Small, dense, strictly convex quadratic programs, and their errors.
//!
//! There are two solvers: [`ActiveSet`](crate::qp::active_set::ActiveSet) for the control loop, and
//! [`InteriorPoint`](crate::qp::interior_point::InteriorPoint), an independent implementation used as fallback and
//! reference.

use nalgebra::{DMatrix, DVector};

/// Pivots of the Hessian's factor below this fraction of the diagonal are rounding errors: the Hessian is not positive
/// definite.
pub(crate) const PIVOT_SHARE: f64 = 16.0 * f64::EPSILON;

/// min ½ xᵀ H x + gᵀ x   subject to   l ≤ Cᵀ x ≤ u.
///
/// The arrays have the size of the largest program; a program of n variables and m constraints uses their leading
/// blocks.
#[derive(Clone, Debug)]
pub struct QuadraticProgram {
    /// H, n × n, symmetric positive definite. Only its lower triangle is read.
    pub hessian: DMatrix<f64>,
    /// g, n.
    pub gradient: DVector<f64>,
    /// C, n × m: each constraint is a column and therefore contiguous in memory.
    pub rows: DMatrix<f64>,
    /// l, m: −∞ for no bound; equal to u for an equality.
    pub lower: DVector<f64>,
    /// u, m: ∞ for no bound.
    pub upper: DVector<f64>,
    variables: usize,
    constraints: usize,
}

/// Reason why a quadratic program has no solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QpError {
    /// No x satisfies the constraints.
    #[error("constraint {row} is inconsistent with the other constraints")]
    Infeasible {
        /// A constraint that contradicts itself or others.
        row: usize,
    },
    /// The Hessian is not positive definite.
    #[error("the Hessian is not positive definite")]
    NotConvex,
    /// NaN or infinity in the data, or an overflow during the solution.
    #[error("the problem data has a NaN or an infinity where a finite number is needed, or overflows")]
    NotFinite,
    /// The solver reached its maximum number of iterations.
    #[error("the solver reached its iteration limit")]
    Iterations,
    /// Any other error, with its description.
    #[error("the solver found no solution: {0}")]
    Unsolved(&'static str),
}

impl QuadraticProgram {
    /// Creates a program of zeros with `variables` and `constraints`, all in use.
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

    /// Sets the number of variables and constraints in use; the data in the arrays do not change.
    ///
    /// # Panics
    /// If the arrays are too small.
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

    /// Coefficients of constraint `i` (n).
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        let start = i * self.rows.nrows();
        &self.rows.as_slice()[start..start + self.variables]
    }

    /// Mutable coefficients of constraint `i` (n).
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        let start = i * self.rows.nrows();
        &mut self.rows.as_mut_slice()[start..start + self.variables]
    }

    /// Column `j` of H, from the diagonal downwards (n − j).
    #[must_use]
    pub fn hessian_column(&self, j: usize) -> &[f64] {
        let start = j * self.hessian.nrows();
        &self.hessian.as_slice()[start + j..start + self.variables]
    }

    /// Checks the data before any arithmetic: arrays that are too small, NaN, infinities other than for missing bounds,
    /// and contradicting bounds are errors.
    #[cfg(feature = "clarabel")]
    pub(crate) fn check(&self) -> Result<(), QpError> {
        let (n, m) = (self.variables, self.constraints);
        self.check_sizes()?;
        let finite = (0..n).all(|j| all_finite(self.hessian_column(j)))
            && all_finite(&self.gradient.as_slice()[..n])
            && (0..m).all(|i| all_finite(self.row(i)));
        if !finite {
            return Err(QpError::NotFinite);
        }
        self.check_bounds()
    }

    /// Checks that the arrays are not too small.
    pub(crate) fn check_sizes(&self) -> Result<(), QpError> {
        let (n, m) = (self.variables, self.constraints);
        let fits = self.hessian.nrows() >= n
            && self.hessian.ncols() >= n
            && self.gradient.len() >= n
            && self.rows.nrows() >= n
            && self.rows.ncols() >= m
            && self.lower.len() >= m
            && self.upper.len() >= m;
        if fits { Ok(()) } else { Err(QpError::Unsolved("an array is smaller than the problem")) }
    }

    /// Checks that no bound is NaN or contradicts itself or the other one.
    pub(crate) fn check_bounds(&self) -> Result<(), QpError> {
        let bounds = || self.lower.as_slice().iter().zip(self.upper.as_slice()).take(self.constraints);
        // NaN compares as false. Without an early exit, as there is nearly always nothing to find.
        let good = bounds().fold(true, |good, (lower, upper)| {
            good & (lower <= upper) & (*lower < f64::INFINITY) & (*upper > f64::NEG_INFINITY)
        });
        if good {
            return Ok(());
        }
        if bounds().any(|(lower, upper)| lower.is_nan() || upper.is_nan()) {
            return Err(QpError::NotFinite);
        }
        let excluded = |(lower, upper): (&f64, &f64)| {
            lower > upper || *lower == f64::INFINITY || *upper == f64::NEG_INFINITY
        };
        bounds().position(excluded).map_or(Ok(()), |row| Err(QpError::Infeasible { row }))
    }

    /// Computes L of H = L Lᵀ into the lower triangle of `factor` (n × n by columns, with the inverse of the diagonal),
    /// column by column.
    #[cfg(feature = "clarabel")]
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

/// Returns aᵀ b.
#[inline]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Adds a x to y.
#[inline]
pub(crate) fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}

/// Returns true if all values are finite. A product with zero is NaN otherwise; there is no early exit, so that the
/// compiler can vectorise the loop.
pub(crate) fn all_finite(values: &[f64]) -> bool {
    let (chunks, rest) = values.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for chunk in chunks {
        sums.iter_mut().zip(chunk).for_each(|(sum, x)| *sum += 0.0 * x);
    }
    sums.iter_mut().zip(rest).for_each(|(sum, x)| *sum += 0.0 * x);
    sums.iter().sum::<f64>() == 0.0
}
