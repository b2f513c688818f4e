//! Preview of an escape: the arm's motion along a direction of the null space, computed without the robot.
//!
//! Nearer to the goal in the first millimetre is not always nearer in the end: rotated to one side, a shoulder below its wrist
//! leads to the goal, to the other side to a stretched arm. A preview therefore continues the motion in steps of the joints,
//! one per control cycle, so that no cycle takes long:
//!
//! ```text
//! δq = δq_above + Σ_i (1 − f_i)/λ_i M⁻¹ J_pᵀ v_i v_iᵀ (e/2 − J δq_above) + f h s
//! ```
//!
//! with the eigenvectors v_i of Λ⁻¹, their weights f_i in an [escape](crate::hierarchy::escape), and the joint motion δq_above
//! that the tasks above need; h is 0.1 rad. Each step halves the errors along directions that the arm controls. Joints stop at their position
//! limits.

use crate::algebra::{add_transposed, product};
use crate::hierarchy::displaced_task::{CORRECTED, DisplacedTask, error};
use crate::hierarchy::mobility_spectrum::MobilitySpectrum;
use crate::nullspace::Nullspace;
use crate::tasks::task::Task;
use nalgebra::{DVector, Matrix6xX, Vector6};
use opspace_model::Model;

/// Number of steps of a preview: half a turn of a joint, and what the error needs to fall to a thousandth.
pub(crate) const STEPS: usize = 45;

/// Motion of the fastest joint along the direction in a step, rad or m.
const STEP: f64 = 0.1;

/// Largest motion of a joint in a step, rad or m.
const LARGEST: f64 = 0.2;

/// Preview of the motion along one direction.
pub(crate) struct Preview {
    /// Direction s, with a largest element of 1 (n).
    direction: DVector<f64>,
    q: DVector<f64>,
    motion: DVector<f64>,
    spectrum: MobilitySpectrum,
}

impl Preview {
    pub(crate) fn new(n: usize) -> Self {
        let zero = DVector::zeros(n);
        Self { direction: zero.clone(), q: zero.clone(), motion: zero, spectrum: MobilitySpectrum::new(n) }
    }

    /// Begins at the joint positions `q` (n) along `sign` times the direction s (n).
    pub(crate) fn begin(&mut self, q: &DVector<f64>, direction: &DVector<f64>, sign: f64) {
        self.q.copy_from(q);
        self.direction.copy_from(direction);
        self.direction *= sign;
    }

    /// Computes a step, and returns the norm of the task's error before it; `None` if the motion cannot be continued. `fade`
    /// is the weight f of an eigenvalue; `lower` and `upper` (n) are the position limits.
    pub(crate) fn step<'a>(
        &mut self,
        displaced: &mut DisplacedTask,
        (model, task): (&Model, &dyn Task),
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)>,
        fade: impl Fn(f64) -> f64 + Copy,
        (lower, upper): (&[f64], &[f64]),
    ) -> Option<f64> {
        if !displaced.displace(model, task, tasks_above, self.q.as_slice()) {
            return None;
        }
        let DisplacedTask { data, above, projected, jacobian, correction, .. } = displaced;
        let own = &projected.jacobian;
        if !self.spectrum.update(&data.mass_matrix_factor, own, task.rows()) {
            return None;
        }
        let error = error(model, data, task);
        let wanted = error * CORRECTED - product(jacobian, correction.as_slice());
        let along = self.spectrum.directions.tr_mul(&wanted);
        let inverse =
            self.spectrum.values.map(|value| if value > 0.0 { (1.0 - fade(value)) / value } else { 0.0 });
        self.motion.copy_from(correction);
        add_transposed(&self.spectrum.joints, &along.component_mul(&inverse), self.motion.as_mut_slice());
        self.drive(above, own, &error, fade);
        for (i, (q, motion)) in self.q.iter_mut().zip(&self.motion).enumerate() {
            *q = (*q + motion.clamp(-LARGEST, LARGEST)).clamp(lower[i], upper[i]);
        }
        Some(error.norm())
    }

    /// Adds the motion along the direction, and lets the direction follow the null space.
    fn drive(
        &mut self,
        above: &Nullspace,
        jacobian: &Matrix6xX<f64>,
        error: &Vector6<f64>,
        fade: impl Fn(f64) -> f64 + Copy,
    ) {
        let lost = self.spectrum.part(error, fade);
        let size = lost.norm();
        above.project_velocity(self.direction.as_mut_slice());
        let controlled = |value: f64| f64::from(u8::from(fade(value) <= 0.0));
        self.spectrum.remove(jacobian, controlled, self.direction.as_mut_slice());
        let largest = self.direction.amax();
        if size <= 0.0 || largest.is_nan() || largest < 1e-3 {
            return;
        }
        self.direction /= largest;
        let along = lost / size;
        let weight = fade(self.spectrum.part(&along, |value| value).dot(&along));
        // The last millimetres need smaller steps.
        let share = (size / (0.1 * error.norm())).min(1.0);
        self.motion.axpy(STEP * weight * share, &self.direction, 1.0);
    }
}
