//! Spectrum of a task's mobility Λ⁻¹, with the joint motion of each eigenvector.

use crate::algebra::{add_transposed, product};
use nalgebra::{Matrix6, Matrix6xX, SymmetricEigen, Vector6};
use opspace_model::MassMatrixFactor;

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
const MAX_ITERATIONS: usize = 1000;

/// Eigenvalues and eigenvectors of Λ⁻¹ = J_p M⁻¹ J_pᵀ.
pub(crate) struct MobilitySpectrum {
    /// Eigenvalues λ_i, 1/kg; those of unused rows are larger than all others.
    pub values: Vector6<f64>,
    /// Eigenvectors v_i, one per column.
    pub directions: Matrix6<f64>,
    /// M⁻¹ J_pᵀ v_i, one per row (6 × n).
    pub joints: Matrix6xX<f64>,
}

impl MobilitySpectrum {
    pub(crate) fn new(n: usize) -> Self {
        Self { values: Vector6::zeros(), directions: Matrix6::zeros(), joints: Matrix6xX::zeros(n) }
    }

    /// Computes the spectrum for the first `rows` rows of J_p (6 × n; unused rows are zero). Returns false if it has none.
    pub(crate) fn update(
        &mut self,
        factor: &MassMatrixFactor,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
    ) -> bool {
        self.joints.copy_from(jacobian);
        let mut mobility = factor.mobility(&mut self.joints);
        factor.finish_solve(&mut self.joints);
        let trace = mobility.trace();
        (rows..6).for_each(|row| mobility[(row, row)] = 2.0 * trace);
        if !mobility.iter().all(|x| x.is_finite()) {
            return false;
        }
        let Some(spectrum) = SymmetricEigen::try_new(mobility, f64::EPSILON, MAX_ITERATIONS) else {
            return false;
        };
        (self.values, self.directions) = (spectrum.eigenvalues, spectrum.eigenvectors);
        for mut column in self.joints.column_iter_mut() {
            let rotated = self.directions.tr_mul(&column);
            column.copy_from(&rotated);
        }
        true
    }

    /// Returns the part of a vector of the rows along the eigenvectors, each weighted by a function of its eigenvalue.
    pub(crate) fn part(&self, rows: &Vector6<f64>, weight: impl Fn(f64) -> f64) -> Vector6<f64> {
        let along = self.directions.tr_mul(rows);
        self.directions * along.zip_map(&self.values, |x, value| x * weight(value))
    }

    /// Removes from the joint motion `z` (n) that of the eigenvectors, each weighted by a function of its eigenvalue; the
    /// weight of an eigenvalue of zero is zero.
    pub(crate) fn remove(&self, jacobian: &Matrix6xX<f64>, weight: impl Fn(f64) -> f64, z: &mut [f64]) {
        let along = self.directions.tr_mul(&product(jacobian, z));
        let force = along.zip_map(&self.values, |x, value| {
            let weight = weight(value);
            if weight > 0.0 { weight * x / value } else { 0.0 }
        });
        add_transposed(&self.joints, &-force, z);
    }
}
