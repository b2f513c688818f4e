//! The operational-space quantities of a task: Λ, J̄ and N.
//!
//! Khatib, *A unified approach for motion and force control of robot manipulators: the operational
//! space formulation*, IEEE J. Robotics and Automation 3(1), 1987:
//!
//! ```text
//! Λ⁻¹ = J M⁻¹ Jᵀ          J̄ = M⁻¹ Jᵀ Λ          N = I − J̄ J
//! ```
//!
//! Close to a singularity, eigenvalues of Λ⁻¹ approach zero and Λ grows without bound. Each
//! eigenvalue λ below `threshold · λ_max` is therefore inverted as `λ/(λ² + μ²)`, with μ² rising smoothly
//! from 0 at the threshold; one above it is inverted exactly. J̄ and N are built from that same Λ, so
//! the damped part of a direction is free to the tasks of lower priority. Other methods of the literature are
//! available for comparison: [`Inversion`].
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, OperationalSpace, frame_jacobian, update};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! assert!(update(&model, &mut data, &[0.4; 6], &[0.0; 6]));
//! let tool = model.frame_id("flange").expect("a link of the file");
//! let mut jacobian = nalgebra::Matrix6xX::zeros(model.n());
//! frame_jacobian(&model, &data, tool, &mut jacobian);
//! // The hand's position, three rows: how heavy it is in each direction.
//! let mut space = OperationalSpace::new(model.n());
//! space.update(&data.mass_matrix_factor, &jacobian, 3, 1e-4);
//! assert!(space.task_inertia[(0, 0)] > 0.0, "kg");
//! // What is left of a torque that must not move it.
//! let mut torque = [1.0; 6];
//! space.project_torque(&jacobian, &mut torque);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::cholesky::MassMatrixFactor;
use nalgebra::{DMatrix, Matrix6, Matrix6xX, SymmetricEigen, Vector6};

/// Inversion of Λ⁻¹ where an eigenvalue λ of it is close to zero. A threshold t is relative to λ_ref: the largest
/// eigenvalue, or the reference given to [`update_with`](OperationalSpace::update_with).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Inversion {
    /// λ/(λ² + μ²) below the threshold t λ_ref, with μ = t λ_ref (1 − (λ/(t λ_ref))²); 1/λ, exactly, above it.
    Damped(f64),
    /// 1/λ for every λ above zero, however small; 0 otherwise.
    Plain,
    /// λ/(λ² + μ²) with μ = t λ_ref everywhere (damped least squares): never exact.
    LeastSquares(f64),
    /// 1/max(λ, t λ_ref): the condition number is bounded, and forces still act along a lost direction.
    Clamped(f64),
}

impl Inversion {
    /// Threshold below which directions are modified, relative to the largest eigenvalue: 0 if none.
    fn threshold(self) -> f64 {
        match self {
            Self::Damped(threshold) | Self::Clamped(threshold) => threshold,
            Self::Plain => 0.0,
            Self::LeastSquares(_) => f64::INFINITY,
        }
    }

    /// Returns the replacement of 1/`value`.
    fn reciprocal(self, value: f64, reference: f64) -> f64 {
        match self {
            Self::Damped(threshold) => damped_reciprocal(value, threshold * reference),
            Self::Plain => damped_reciprocal(value, 0.0),
            Self::LeastSquares(threshold) => {
                let (value, mu) = (value.max(0.0), threshold * reference);
                value / (value * value + mu * mu)
            }
            Self::Clamped(threshold) => 1.0 / value.max(threshold * reference),
        }
    }
}

/// Λ and J̄ of one task of up to six rows; preallocated for n joints.
#[derive(Clone, Debug)]
pub struct OperationalSpace {
    /// Λ, the task's inertia (kg, kg m, kg m²): rows and columns past the task's are zero.
    pub task_inertia: Matrix6<f64>,
    /// J̄ᵀ (6 × n), with J̄ the dynamically consistent inverse of J: rows past the task's are zero. It maps joint
    /// torques to the task's forces.
    pub jbar_transpose: Matrix6xX<f64>,
    /// Share of the weakest eigen-direction of Λ⁻¹ (smallest eigenvalue) that the task still has: 1 if
    /// nothing is damped, 0 if a direction is lost.
    pub min_singular_gain: f64,
}

impl OperationalSpace {
    /// Allocates for a task on a robot of `n` joints.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { task_inertia: Matrix6::zeros(), jbar_transpose: Matrix6xX::zeros(n), min_singular_gain: 1.0 }
    }

    /// Computes Λ and J̄ for the first `rows` rows of `jacobian`, with the mass matrix's factor at its state.
    ///
    /// `threshold` is the ratio to the largest eigenvalue of Λ⁻¹ below which a direction is damped
    /// (0: none is). Rows of different units must have been scaled to one beforehand for that ratio to
    /// mean anything. If the Jacobian or the factor is not finite, Λ and the share are zero.
    ///
    /// # Panics
    /// If `rows` is more than six or the sizes differ.
    pub fn update(
        &mut self,
        factor: &MassMatrixFactor,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        threshold: f64,
    ) {
        self.update_with(factor, jacobian, rows, Inversion::Damped(threshold), None);
    }

    /// Variant of [`update`](Self::update) with Λ⁻¹ inverted in another way, or thresholds relative to another
    /// `reference` (1/kg) than the largest eigenvalue.
    ///
    /// # Panics
    /// As [`update`](Self::update).
    pub fn update_with(
        &mut self,
        factor: &MassMatrixFactor,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        inversion: Inversion,
        reference: Option<f64>,
    ) {
        self.update_inertia(factor, jacobian, rows, inversion, reference);
        self.compute_jbar(factor);
    }

    /// Computes the first half of [`update_with`](Self::update_with), if J̄ may not be needed: Λ and the smallest
    /// singular gain. J̄ᵀ holds the intermediate result that [`compute_jbar`](Self::compute_jbar) needs.
    ///
    /// # Panics
    /// As [`update`](Self::update).
    pub fn update_inertia(
        &mut self,
        factor: &MassMatrixFactor,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        inversion: Inversion,
        reference: Option<f64>,
    ) {
        assert!(rows <= 6, "a task has six rows at most");
        let half = &mut self.jbar_transpose;
        half.as_mut_slice().copy_from_slice(jacobian.as_slice());
        for r in rows..6 {
            half.row_mut(r).fill(0.0);
        }
        let inverse_inertia = factor.mobility(half);
        (self.task_inertia, self.min_singular_gain) =
            damped_inverse(inverse_inertia, rows, inversion, reference);
    }

    /// Computes the second half, J̄ᵀ, once after each [`update_inertia`](Self::update_inertia).
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn compute_jbar(&mut self, factor: &MassMatrixFactor) {
        let half = &mut self.jbar_transpose;
        factor.finish_solve(half);
        let (columns, _) = half.as_mut_slice().as_chunks_mut::<6>();
        for column in columns {
            *column = (self.task_inertia * Vector6::from(*column)).into();
        }
    }

    /// Replaces τ by Nᵀ τ = τ − Jᵀ J̄ᵀ τ, with the Jacobian of the last [`update`](Self::update): the part of the joint
    /// torques `tau` (n; Nm) that doesn't accelerate the task.
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn project_torque(&self, jacobian: &Matrix6xX<f64>, tau: &mut [f64]) {
        assert!(jacobian.ncols() == self.jbar_transpose.ncols() && tau.len() == jacobian.ncols());
        let mut force = Vector6::zeros();
        for (column, &t) in self.jbar_transpose.column_iter().zip(tau.iter()) {
            force += column * t;
        }
        for (t, column) in tau.iter_mut().zip(jacobian.column_iter()) {
            *t -= column.dot(&force);
        }
    }

    /// N = I − J̄ J (n × n), acting on velocities; its transpose projects torques. With the Jacobian of the last
    /// [`update`](Self::update).
    ///
    /// # Panics
    /// If the sizes differ.
    pub fn nullspace(&self, jacobian: &Matrix6xX<f64>, out: &mut DMatrix<f64>) {
        let n = self.jbar_transpose.ncols();
        assert!(jacobian.ncols() == n && out.shape() == (n, n));
        for (k, column) in jacobian.column_iter().enumerate() {
            for (i, row) in self.jbar_transpose.column_iter().enumerate() {
                out[(i, k)] = f64::from(u8::from(i == k)) - row.dot(&column);
            }
        }
    }
}

/// Inverse of the leading `rows` × `rows` block, damped in its spectrum below the threshold, and the
/// remaining share of its weakest direction.
fn damped_inverse(
    mut a: Matrix6<f64>,
    rows: usize,
    inversion: Inversion,
    reference: Option<f64>,
) -> (Matrix6<f64>, f64) {
    let trace = a.trace();
    if !trace.is_finite() {
        return (Matrix6::zeros(), 0.0);
    }
    if trace <= 0.0 {
        return (Matrix6::zeros(), if rows == 0 { 1.0 } else { 0.0 });
    }
    // Rows that the task doesn't have become directions of their own, beyond every eigenvalue it has.
    let padding = 2.0 * trace;
    for r in rows..6 {
        a[(r, r)] = padding;
    }
    let (mut inverse, weakest_share) =
        match certified_inverse(&a, rows, reference.unwrap_or(trace), inversion.threshold()) {
            Some(inverse) => (inverse, 1.0),
            // One that isn't finite has spoilt a pivot.
            None if a.iter().any(|x| !x.is_finite()) => (Matrix6::zeros(), 0.0),
            None => spectral_inverse(a, trace, inversion, reference),
        };
    for r in rows..6 {
        inverse[(r, r)] = 0.0;
    }
    (inverse, weakest_share)
}

/// Plain inverse, if it is certain without the spectrum that no eigenvalue is below the threshold:
/// λ_min ≥ 1/tr(A⁻¹), and λ_max ≤ tr(A) where that is the reference.
fn certified_inverse(a: &Matrix6<f64>, rows: usize, reference: f64, threshold: f64) -> Option<Matrix6<f64>> {
    let inverse = positive_inverse(a)?;
    let inverse_trace: f64 = (0..rows).map(|r| inverse[(r, r)]).sum();
    (1.0 >= threshold * reference * inverse_trace).then_some(inverse)
}

/// Inverse of a symmetric matrix by Gauss-Jordan elimination without pivoting, which is stable if the
/// matrix is positive definite; `None` if a pivot shows that it isn't.
fn positive_inverse(a: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let mut swept = *a;
    for k in 0..6 {
        let pivot = swept[(k, k)];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let reciprocal = 1.0 / pivot;
        let mut column = swept.column(k).into_owned();
        column[k] = 0.0;
        let scaled = column * reciprocal;
        for c in 0..6 {
            let factor = swept[(k, c)];
            let mut target = swept.column_mut(c);
            target -= scaled * factor;
            target[k] = factor * reciprocal;
        }
        swept.set_column(k, &-scaled);
        swept[(k, k)] = reciprocal;
    }
    Some(swept)
}

fn spectral_inverse(
    a: Matrix6<f64>,
    trace: f64,
    inversion: Inversion,
    reference: Option<f64>,
) -> (Matrix6<f64>, f64) {
    let spectrum = SymmetricEigen::new(a);
    // The padding lies above the trace, all eigenvalues of the task below it.
    let largest = spectrum.eigenvalues.iter().filter(|&&v| v <= 1.5 * trace).fold(0.0, |m: f64, &v| m.max(v));
    let reference = reference.unwrap_or(largest);
    let mut inverse = Matrix6::zeros();
    let mut weakest_share: f64 = 1.0;
    for (&value, vector) in spectrum.eigenvalues.iter().zip(spectrum.eigenvectors.column_iter()) {
        let gain = inversion.reciprocal(value, reference);
        weakest_share = weakest_share.min((gain * value).max(0.0));
        inverse += vector * vector.transpose() * gain;
    }
    (inverse, weakest_share)
}

/// 1/λ at or above `floor`; below it λ/(λ² + μ²) with μ² = floor² (1 − (λ/floor)²)², which joins 1/λ with
/// its slope and goes to zero with λ.
fn damped_reciprocal(value: f64, floor: f64) -> f64 {
    if value >= floor && value > 0.0 {
        return 1.0 / value;
    }
    if value <= 0.0 {
        return 0.0;
    }
    let ratio = value / floor;
    let mu = floor * (1.0 - ratio * ratio);
    value / (value * value + mu * mu)
}
