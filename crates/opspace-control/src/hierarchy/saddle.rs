//! Saddle of a task's error at a singular pose: the direction of the joints along which the error falls.
//!
//! Let e be the error along the directions that the arm has lost, J_pᵀ e = 0 their joint torque, and z joint motion in
//! the null space of the tasks above and of all other directions of the task. The arm stays where it is, but its motion
//! along z changes the torque by
//!
//! ```text
//! d(J_pᵀ e) = G z        G = ∂(J_pᵀ e)/∂q
//! ```
//!
//! For rows of positions, zᵀ G z = Σ_r e_r zᵀ H_r z with the Hessians H_r of the rows: the acceleration J̇(z) z along e.
//! If zᵀ G z is positive, motion along ±z moves the task towards the goal; this is the elbow of a straight arm.
//!
//! The other directions follow. With p_i = M⁻¹ J_pᵀ v_i/√λ_i the joint motion of the eigenvector v_i of Λ⁻¹, a unit mass,
//! their torque changes by p_iᵀ G z and by −λ_i per motion along p_i: it vanishes at p_iᵀ G z/λ_i. There, the torque along z
//! changes by
//!
//! ```text
//! S = Zᵀ G Z + Σ_i (p_iᵀ G Z)ᵀ (p_iᵀ G Z)/λ_i
//! ```
//!
//! with a basis Z of such motion, of unit mass (Zᵀ M Z = 1). The second term is what rotates a lost direction until the
//! goal is no longer along it: a shoulder below its wrist, or two parallel axes of a wrist. S is minus the Hessian of
//! ½ |e|², in which all other errors remain zero (Schur complement). If its largest eigenvalue is positive, the pose is a
//! saddle, and its eigenvector the steepest way down. Otherwise no motion comes nearer to the goal: an arm that is
//! stretched out to a goal beyond its reach.
//!
//! G is the difference of J_pᵀ e at two poses, one for each vector of the basis, so that any task can be used.

use crate::algebra::{add_transposed, dot, multiply, product};
use crate::hierarchy::displaced_task::{DisplacedTask, error};
use crate::hierarchy::mobility_spectrum::MobilitySpectrum;
use crate::nullspace::Nullspace;
use crate::tasks::task::Task;
use nalgebra::{DMatrix, DVector, Matrix6xX, Vector6};
use opspace_model::{Data, Model};

/// Step of a joint for the derivative, rad or m: the errors of truncation and rounding are both below 1e-4 of G.
const STEP: f64 = 1e-5;

/// Smallest remaining part of a joint's motion that counts as a new vector of the basis (squared, relative).
const INDEPENDENT: f64 = 1e-6;

/// Number of steps of the power iteration. A direction that is not the steepest one leads down, too.
const ITERATIONS: usize = 100;

/// Mobility relative to the typical one above which a direction follows as computed. Less mobile ones are damped.
const FOLLOWS: f64 = 0.005;

/// Pose of an arm at which a task has lost a direction.
pub(crate) struct LostPose<'a> {
    pub model: &'a Model,
    pub data: &'a Data,
    pub task: &'a dyn Task,
    /// J_p (6 × n).
    pub jacobian: &'a Matrix6xX<f64>,
    /// Null space of the tasks above.
    pub above: &'a Nullspace,
    pub spectrum: &'a MobilitySpectrum,
    /// Typical mobility of the task, 1/kg.
    pub typical: f64,
    /// Mobility below which a direction is lost, 1/kg.
    pub lost: f64,
}

/// Search for the steepest direction, with its buffers.
pub(crate) struct Saddle {
    /// J_pᵀ e (n).
    torque: DVector<f64>,
    /// Basis Z, and M Z; the first columns are in use (n × n).
    basis: DMatrix<f64>,
    momenta: DMatrix<f64>,
    /// G Z (n × n).
    changes: DMatrix<f64>,
    /// S (n × n).
    curvature: DMatrix<f64>,
    /// Eigenvector in the coordinates of the basis, and S times it (n).
    coordinates: DVector<f64>,
    image: DVector<f64>,
}

impl Saddle {
    pub(crate) fn new(n: usize) -> Self {
        let (vector, square) = (DVector::zeros(n), DMatrix::zeros(n, n));
        Self {
            torque: vector.clone(),
            basis: square.clone(),
            momenta: square.clone(),
            changes: square.clone(),
            curvature: square,
            coordinates: vector.clone(),
            image: vector,
        }
    }

    /// Writes the steepest direction (n, of unit mass) into `direction`, and returns the largest eigenvalue of S in 1/kg.
    /// Returns 0 if no motion is left. `tasks_above` are the tasks above, in order of priority, with their typical
    /// mobilities.
    pub(crate) fn steepest<'a>(
        &mut self,
        displaced: &mut DisplacedTask,
        pose: &LostPose<'_>,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)> + Clone,
        direction: &mut [f64],
    ) -> f64 {
        let freedom = self.span(pose);
        let lost = pose.lost;
        let present = error(pose.model, pose.data, pose.task);
        let kept = pose.spectrum.part(&present, |value| f64::from(u8::from(value >= lost)));
        self.torque.fill(0.0);
        add_transposed(pose.jacobian, &(present - kept), self.torque.as_mut_slice());
        for k in 0..freedom {
            if !self.differentiate(displaced, pose, tasks_above.clone(), &kept, k) {
                return 0.0;
            }
        }
        self.complement(pose, freedom);
        let largest = self.largest_eigenvalue(freedom);
        direction.fill(0.0);
        for (k, column) in self.basis.column_iter().take(freedom).enumerate() {
            direction.iter_mut().zip(&column).for_each(|(s, z)| *s += self.coordinates[k] * z);
        }
        largest
    }

    /// Computes the basis by Gram-Schmidt orthogonalisation of the joints' motions; returns the number of its vectors.
    fn span(&mut self, pose: &LostPose<'_>) -> usize {
        let n = self.torque.len();
        let mass_matrix = &pose.data.mass_matrix;
        let mut freedom = 0;
        for joint in 0..n {
            let (before, rest) = self.basis.as_mut_slice().split_at_mut(freedom * n);
            let z = &mut rest[..n];
            z.fill(0.0);
            z[joint] = 1.0;
            pose.above.project_velocity(z);
            let regular = |value: f64| f64::from(u8::from(value >= pose.lost));
            pose.spectrum.remove(pose.jacobian, regular, z);
            let (momenta, rest) = self.momenta.as_mut_slice().split_at_mut(freedom * n);
            for (vector, momentum) in before.chunks_exact(n).zip(momenta.chunks_exact(n)) {
                let part = dot(momentum, z);
                z.iter_mut().zip(vector).for_each(|(z, vector)| *z -= part * vector);
            }
            let momentum = &mut rest[..n];
            multiply(mass_matrix, z, momentum);
            let mass = dot(z, momentum);
            if mass > INDEPENDENT * mass_matrix[(joint, joint)] {
                let scale = 1.0 / mass.sqrt();
                z.iter_mut().chain(momentum).for_each(|x| *x *= scale);
                freedom += 1;
            }
        }
        freedom
    }

    /// Computes G times vector k of the basis; `kept` is the error along directions that are not lost. Returns false if the
    /// arm has no dynamics at the displaced pose.
    fn differentiate<'a>(
        &mut self,
        displaced: &mut DisplacedTask,
        pose: &LostPose<'_>,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)>,
        kept: &Vector6<f64>,
        k: usize,
    ) -> bool {
        let (model, task) = (pose.model, pose.task);
        let step = STEP / self.basis.column(k).amax();
        self.coordinates.copy_from(&self.basis.column(k));
        self.coordinates *= step;
        self.coordinates.iter_mut().zip(&pose.data.q).for_each(|(q, at)| *q += at);
        if !displaced.displace(model, task, tasks_above, self.coordinates.as_slice()) {
            return false;
        }
        let lost = error(model, &displaced.data, task) - kept;
        let mut change = self.changes.column_mut(k);
        change.fill(0.0);
        add_transposed(&displaced.projected.jacobian, &lost, change.as_mut_slice());
        change -= &self.torque;
        change /= step;
        true
    }

    /// Computes S.
    fn complement(&mut self, pose: &LostPose<'_>, freedom: usize) {
        for k in 0..freedom {
            let follows = |value: f64| if value >= FOLLOWS * pose.typical { 1.0 / value } else { 0.0 };
            let along = |l: usize| product(&pose.spectrum.joints, self.changes.column(l).as_slice());
            // p_iᵀ G z/λ_i with p_i = joints/√λ_i.
            let answer = along(k).zip_map(&pose.spectrum.values, |x, value| x * follows(value).powi(2));
            for l in 0..freedom {
                let own = self.basis.column(l).dot(&self.changes.column(k));
                self.curvature[(l, k)] = own + along(l).dot(&answer);
            }
        }
        for k in 0..freedom {
            for l in 0..k {
                let mean = 0.5 * (self.curvature[(l, k)] + self.curvature[(k, l)]);
                (self.curvature[(l, k)], self.curvature[(k, l)]) = (mean, mean);
            }
        }
    }

    /// Computes the largest eigenvalue of S and its eigenvector, by power iteration of S shifted to positive eigenvalues.
    fn largest_eigenvalue(&mut self, freedom: usize) -> f64 {
        let curvature = self.curvature.view((0, 0), (freedom, freedom));
        let shift = curvature.column_iter().map(|column| column.lp_norm(1)).fold(0.0, f64::max);
        // No eigenvector of a pose with symmetries is orthogonal to it.
        (0..freedom).for_each(|k| self.coordinates[k] = 1.0 / (1.0 + k as f64));
        (freedom..self.coordinates.len()).for_each(|k| self.coordinates[k] = 0.0);
        let mut value = 0.0;
        for _ in 0..ITERATIONS {
            let size = self.coordinates.norm();
            if size <= 0.0 || !size.is_finite() {
                return 0.0;
            }
            self.coordinates /= size;
            self.image.fill(0.0);
            for (k, column) in curvature.column_iter().enumerate() {
                self.image.rows_mut(0, freedom).axpy(self.coordinates[k], &column, 1.0);
            }
            value = self.image.dot(&self.coordinates);
            self.coordinates *= shift;
            self.coordinates += &self.image;
        }
        let size = self.coordinates.norm();
        self.coordinates /= size;
        value
    }
}
