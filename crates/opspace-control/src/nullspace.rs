//! Strict task priorities: the null space of the tasks above, and the projection of a task into it.
//!
//! With N the null-space projector of all tasks above (N acts on velocities, Nᵀ on torques), a task with Jacobian J has
//!
//! ```text
//! J_p = J N        Λ_p = (J_p M⁻¹ J_pᵀ)⁻¹        N ← N (I − J̄_p J_p)
//! ```
//!
//! (Sentis and Khatib, *Synthesis of whole-body behaviors through hierarchical control of behavioral primitives*, Int.
//! J. Humanoid Robotics 2(4), 2005). Torques J_pᵀ F then cause no acceleration of the tasks above. The same recursion
//! with the identity instead of M is used for inverse kinematics.

use crate::algebra::{add_transposed, product};
use nalgebra::{Matrix6, Matrix6xX, Vector6};
use opspace_model::{Inversion, MassMatrixFactor, OperationalSpace};

/// Null-space projector N of the tasks pushed so far: the product of one factor I − J̄_p J_p per task. The n × n matrix
/// is never formed.
#[derive(Clone, Debug)]
pub(crate) struct Nullspace {
    /// J_p and J̄_pᵀ (6 × n) of each task; only the first `depth` entries are in use.
    tasks: Vec<(Matrix6xX<f64>, Matrix6xX<f64>)>,
    depth: usize,
}

impl Nullspace {
    /// Null-space projector for at most `levels` tasks on a robot of `n` joints.
    pub(crate) fn new(n: usize, levels: usize) -> Self {
        Self { tasks: vec![(Matrix6xX::zeros(n), Matrix6xX::zeros(n)); levels], depth: 0 }
    }

    /// Resets N to the identity: no task is pushed.
    pub(crate) fn reset(&mut self) {
        self.depth = 0;
    }

    /// Returns true if no task is pushed, i.e. N is the identity.
    pub(crate) fn is_empty(&self) -> bool {
        self.depth == 0
    }

    /// Restores N of the first `depth` of the tasks that were pushed since the last [`reset`](Self::reset).
    pub(crate) fn truncate(&mut self, depth: usize) {
        debug_assert!(depth <= self.tasks.len());
        self.depth = depth;
    }

    /// Adds a [complete](ProjectedTask::compute_jbar) `task`: N excludes its motion from now on.
    pub(crate) fn push(&mut self, task: &ProjectedTask) {
        let (jacobian, jbar_transpose) = &mut self.tasks[self.depth];
        jacobian.copy_from(&task.jacobian);
        jbar_transpose.copy_from(&task.space.jbar_transpose);
        self.depth += 1;
    }

    fn tasks(&self) -> impl DoubleEndedIterator<Item = &(Matrix6xX<f64>, Matrix6xX<f64>)> {
        self.tasks[..self.depth].iter()
    }

    /// Replaces τ by Nᵀ τ.
    pub(crate) fn project_torque(&self, torque: &mut [f64]) {
        for (jacobian, jbar_transpose) in self.tasks() {
            remove(torque, jbar_transpose, jacobian);
        }
    }

    /// Replaces v by N v.
    pub(crate) fn project_velocity(&self, velocity: &mut [f64]) {
        for (jacobian, jbar_transpose) in self.tasks().rev() {
            remove(velocity, jacobian, jbar_transpose);
        }
    }

    /// Replaces the torques τ = M a by Nᵀ τ, where N includes `task`, which is below all pushed tasks; J̄ of `task` is
    /// not needed. Replaces a by N a, where N does not include `task`.
    pub(crate) fn project_above(&self, task: &ProjectedTask, acceleration: &mut [f64], torque: &mut [f64]) {
        self.project_torque(torque);
        self.project_velocity(acceleration);
        let force = task.space.task_inertia * product(&task.jacobian, acceleration);
        add_transposed(&task.jacobian, &-force, torque);
    }

    /// Replaces J by J N.
    fn project_jacobian(&self, jacobian: &mut Matrix6xX<f64>) {
        for (above, jbar_transpose) in self.tasks() {
            // J J̄: the part of this task's motion that the task above determines.
            let mut taken = Matrix6::zeros();
            for (j, inverse) in jacobian.column_iter().zip(jbar_transpose.column_iter()) {
                for (c, &x) in inverse.iter().enumerate() {
                    taken.column_mut(c).axpy(x, &j, 1.0);
                }
            }
            for (mut j, above) in jacobian.column_iter_mut().zip(above.column_iter()) {
                j -= taken * above;
            }
        }
    }
}

/// Replaces x by x − Aᵀ B x.
fn remove(x: &mut [f64], b: &Matrix6xX<f64>, a: &Matrix6xX<f64>) {
    let sum = product(b, x);
    add_transposed(a, &-sum, x);
}

/// A task of at most six rows, projected into the null space of the tasks above.
#[derive(Clone, Debug)]
pub(crate) struct ProjectedTask {
    /// Projected Jacobian J_p (6 × n), scaled like the task's rows.
    pub jacobian: Matrix6xX<f64>,
    pub space: OperationalSpace,
}

impl ProjectedTask {
    pub(crate) fn new(n: usize) -> Self {
        let jacobian = Matrix6xX::zeros(n);
        Self { jacobian, space: OperationalSpace::new(n) }
    }

    /// Sets J_p for the Jacobian of a task (6 × n) below the tasks of `above`.
    pub(crate) fn project(&mut self, above: &Nullspace, jacobian: &Matrix6xX<f64>) {
        self.jacobian.copy_from(jacobian);
        if above.depth > 0 {
            above.project_jacobian(&mut self.jacobian);
        }
    }

    /// Computes all quantities except J̄ for the first `rows` rows of J_p. The singularity threshold is relative to
    /// `reference`; `demand` is the acceleration that the task demands of its rows, if it is known.
    pub(crate) fn update(
        &mut self,
        factor: &MassMatrixFactor,
        rows: usize,
        inversion: Inversion,
        reference: f64,
        demand: Option<&Vector6<f64>>,
    ) {
        self.space.update_inertia(factor, &self.jacobian, rows, inversion, Some(reference), demand);
    }

    /// Computes J̄ with the same factor. Call it once after each [`update`](Self::update) if there is a task below.
    pub(crate) fn compute_jbar(&mut self, factor: &MassMatrixFactor) {
        self.space.compute_jbar(factor);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use nalgebra::{DMatrix, Matrix3, Vector3};
    use opspace_model::{Data, Inertia, Joint, JointKind, Limits, Model, Placement, frame_jacobian, update};

    /// A chain of `n` identical links, each rotated relative to the previous one.
    pub(crate) fn chain(n: usize) -> Model {
        let mut model = Model::new("chain");
        for i in 0..n {
            let joint = Joint { name: format!("j{i}"), kind: JointKind::Continuous, limits: Limits::NONE };
            let inertia = Inertia {
                mass: 1.0,
                com: Vector3::new(0.02, 0.01, 0.1),
                rotational: Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.01)),
            };
            let origin = Placement::from_rpy([1.1, 0.4, -0.3], [0.05, 0.02, 0.25]);
            model.add_body(i.checked_sub(1), origin, joint, inertia);
        }
        for (name, body) in [("middle", n / 2), ("end", n - 1)] {
            model.add_frame(name, Some(body), Placement::from_rpy([0.0; 3], [0.1, 0.0, 0.05]));
        }
        model.with_rotor_inertia(&vec![0.01; n])
    }

    /// N (n × n), computed column by column from N v and from Nᵀ τ.
    fn matrices(nullspace: &Nullspace, n: usize) -> [DMatrix<f64>; 2] {
        let projected = |project: &dyn Fn(&mut [f64])| {
            let mut identity = DMatrix::identity(n, n);
            identity.column_iter_mut().for_each(|mut column| project(column.as_mut_slice()));
            identity
        };
        [
            projected(&|v| nullspace.project_velocity(v)),
            projected(&|t| nullspace.project_torque(t)).transpose(),
        ]
    }

    /// Compared, after each of three tasks: J N of every task so far with zero; and N M⁻¹ with its transpose (only if
    /// it is symmetric does Nᵀ project torques). Entries of J and N are of the order of 1.
    #[test]
    fn nullspace_moves_no_higher_task() {
        let (n, tolerance) = (8, 1e-11);
        let model = chain(n);
        let mut data = Data::new(&model);
        let q: Vec<f64> = (0..n).map(|i| 0.4 * (1.0 + i as f64).sin()).collect();
        assert!(update(&model, &mut data, &q, &vec![0.0; n]));
        let mass_inverse = data.mass_matrix.clone().try_inverse().expect("M is regular");
        let rows_of = |name: &str, rows: std::ops::Range<usize>| {
            let mut j = Matrix6xX::zeros(n);
            frame_jacobian(&model, &data, model.frame_id(name).expect("frame"), &mut j);
            let mut selected = Matrix6xX::zeros(n);
            selected.rows_mut(0, rows.len()).copy_from(&j.rows(rows.start, rows.len()));
            (selected, rows.len())
        };
        let tasks = [rows_of("end", 0..3), rows_of("middle", 0..2), rows_of("end", 3..5)];
        let mut nullspace = Nullspace::new(n, tasks.len());
        let mut projected = ProjectedTask::new(n);
        for (level, (jacobian, rows)) in tasks.iter().enumerate() {
            projected.project(&nullspace, jacobian);
            projected.update(&data.mass_matrix_factor, *rows, Inversion::Damped(1e-6), 1.0, None);
            assert!(projected.space.min_singular_gain == 1.0, "level {level} is regular");
            projected.compute_jbar(&data.mass_matrix_factor);
            nullspace.push(&projected);
            let [matrix, by_torque] = matrices(&nullspace, n);
            assert!((&matrix - by_torque).amax() < tolerance, "one N for velocities and torques");
            for (above, (jacobian, _)) in tasks[..=level].iter().enumerate() {
                let left = (jacobian * &matrix).amax();
                assert!(left < tolerance, "below level {level}, level {above} still moves by {left}");
            }
            let product = &matrix * &mass_inverse;
            assert!((&product - product.transpose()).amax() < tolerance * mass_inverse.amax());
        }
        let [matrix, _] = matrices(&nullspace, n);
        let rank = matrix.singular_values().iter().filter(|&&v| v > 1e-6).count();
        assert_eq!(rank, n - 7, "what is left of the joints' freedom");
    }
}
