//! The operational-space quantities of a task: Λ, J̄ and N.
//!
//! Khatib, *A unified approach for motion and force control of robot manipulators: the operational
//! space formulation*, IEEE J. Robotics and Automation 3(1), 1987:
//!
//! ```text
//! Λ⁻¹ = J M⁻¹ Jᵀ          J̄ = M⁻¹ Jᵀ Λ          N = I − J̄ J
//! ```
//!
//! Where the task can hardly move the robot, eigenvalues of Λ⁻¹ come near zero and Λ explodes. Each
//! eigenvalue λ below `threshold · λ_max` is therefore inverted as `λ/(λ² + μ²)`, with μ² rising smoothly
//! from 0 at the threshold; one above it is inverted exactly. J̄ and N are built from that same Λ, so
//! what a damped direction does not carry is free to the tasks below.

use crate::cholesky::cholesky_solve;
use crate::data::Data;
use nalgebra::{DMatrix, Matrix6, Matrix6xX, SymmetricEigen, Vector6};

/// Λ, J̄ and N of one task of up to six rows; preallocated for n joints.
#[derive(Clone, Debug)]
pub struct OperationalSpace {
    /// Λ, the task's inertia (kg, kg m, kg m²): rows and columns past the task's are zero.
    pub task_inertia: Matrix6<f64>,
    /// J̄ (n × 6), the dynamically consistent inverse of J: columns past the task's are zero.
    pub dynamically_consistent_inverse: DMatrix<f64>,
    /// N (n × n), acting on velocities; its transpose projects torques.
    pub nullspace: DMatrix<f64>,
    /// The share of each eigen-direction of Λ⁻¹ that the task still has, smallest eigenvalue's: 1 if
    /// nothing is damped, 0 if a direction is lost.
    pub weakest_share: f64,
    minv_jt: DMatrix<f64>,
}

impl OperationalSpace {
    /// Room for a task on a robot of `n` joints.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self {
            task_inertia: Matrix6::zeros(),
            dynamically_consistent_inverse: DMatrix::zeros(n, 6),
            nullspace: DMatrix::identity(n, n),
            weakest_share: 1.0,
            minv_jt: DMatrix::zeros(n, 6),
        }
    }

    /// Computes all of it for the first `rows` rows of `jacobian`, at the state of `data`, whose mass
    /// matrix must have been factored ([`update`](crate::update)).
    ///
    /// `threshold` is the ratio to the largest eigenvalue of Λ⁻¹ below which a direction is damped
    /// (0: none is). Rows of different units must have been scaled to one beforehand for that ratio to
    /// mean anything.
    ///
    /// # Panics
    /// If `rows` is more than six or the sizes differ.
    pub fn update(&mut self, data: &Data, jacobian: &Matrix6xX<f64>, rows: usize, threshold: f64) {
        let n = jacobian.ncols();
        assert!(rows <= 6 && self.nullspace.nrows() == n && data.q.len() == n);
        for r in 0..6 {
            let mut column = self.minv_jt.column_mut(r);
            if r < rows {
                column.tr_copy_from(&jacobian.row(r));
                cholesky_solve(&data.mass_matrix_factor, column.as_mut_slice());
            } else {
                column.fill(0.0);
            }
        }
        let mut inverse_inertia = Matrix6::zeros();
        for r in 0..rows {
            for c in 0..=r {
                let entry = (0..n).map(|k| jacobian[(r, k)] * self.minv_jt[(k, c)]).sum();
                inverse_inertia[(r, c)] = entry;
                inverse_inertia[(c, r)] = entry;
            }
        }
        (self.task_inertia, self.weakest_share) = damped_inverse(inverse_inertia, rows, threshold);
        for i in 0..n {
            let row = Vector6::from_fn(|r, _| self.minv_jt[(i, r)]);
            let weighted = self.task_inertia * row;
            for r in 0..6 {
                self.dynamically_consistent_inverse[(i, r)] = weighted[r];
            }
            for k in 0..n {
                let carried = weighted.dot(&jacobian.column(k));
                self.nullspace[(i, k)] = f64::from(u8::from(i == k)) - carried;
            }
        }
    }
}

/// The inverse of the leading `rows` × `rows` block, damped in its spectrum below the threshold, and the
/// share that is left of its weakest direction.
fn damped_inverse(mut a: Matrix6<f64>, rows: usize, threshold: f64) -> (Matrix6<f64>, f64) {
    let trace = a.trace();
    if trace <= 0.0 {
        return (Matrix6::zeros(), if rows == 0 { 1.0 } else { 0.0 });
    }
    // Rows that the task doesn't have become directions of their own, beyond every eigenvalue it has.
    let padding = 2.0 * trace;
    for r in rows..6 {
        a[(r, r)] = padding;
    }
    let (mut inverse, weakest_share) = match certified_inverse(&a, rows, trace, threshold) {
        Some(inverse) => (inverse, 1.0),
        None => spectral_inverse(a, trace, threshold),
    };
    for r in rows..6 {
        inverse[(r, r)] = 0.0;
    }
    (inverse, weakest_share)
}

/// The plain inverse, if it is certain without the spectrum that no eigenvalue is below the threshold:
/// λ_min ≥ 1/tr(A⁻¹) and λ_max ≤ tr(A).
fn certified_inverse(a: &Matrix6<f64>, rows: usize, trace: f64, threshold: f64) -> Option<Matrix6<f64>> {
    let inverse = a.cholesky()?.inverse();
    let inverse_trace: f64 = (0..rows).map(|r| inverse[(r, r)]).sum();
    (1.0 >= threshold * trace * inverse_trace).then_some(inverse)
}

fn spectral_inverse(a: Matrix6<f64>, trace: f64, threshold: f64) -> (Matrix6<f64>, f64) {
    let spectrum = SymmetricEigen::new(a);
    // The padding lies above the trace, all eigenvalues of the task below it.
    let largest = spectrum.eigenvalues.iter().filter(|&&v| v <= 1.5 * trace).fold(0.0, |m: f64, &v| m.max(v));
    let floor = threshold * largest;
    let mut inverse = Matrix6::zeros();
    let mut weakest_share: f64 = 1.0;
    for (&value, vector) in spectrum.eigenvalues.iter().zip(spectrum.eigenvectors.column_iter()) {
        let gain = damped_reciprocal(value, floor);
        weakest_share = weakest_share.min(gain * value);
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
