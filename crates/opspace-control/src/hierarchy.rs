//! Strict priorities: what freedom the tasks above leave, and a task within it.
//!
//! With N the nullspace of all tasks above (it acts on velocities, Nᵀ on torques), a task J has
//!
//! ```text
//! J_p = J N        Λ_p = (J_p M⁻¹ J_pᵀ)⁻¹        N ← N (I − J̄_p J_p)
//! ```
//!
//! (Sentis and Khatib, *Synthesis of whole-body behaviors through hierarchical control of behavioral
//! primitives*, Int. J. Humanoid Robotics 2(4), 2005). Torques J_pᵀ F then accelerate no task above.
//! With the identity in M's place the same recursion is that of inverse kinematics.

use nalgebra::{DMatrix, DVector, Matrix6xX};
use opspace_model::{Data, OperationalSpace, cholesky_solve};

/// N, the freedom that the tasks so far leave.
#[derive(Clone, Debug)]
pub(crate) struct Nullspace {
    matrix: DMatrix<f64>,
    before: DMatrix<f64>,
    /// No task so far: N is the identity, and needn't be multiplied by.
    whole: bool,
}

impl Nullspace {
    pub(crate) fn new(n: usize) -> Self {
        Self { matrix: DMatrix::identity(n, n), before: DMatrix::identity(n, n), whole: true }
    }

    /// All freedom, before the first task.
    pub(crate) fn reset(&mut self) {
        self.matrix.fill_with_identity();
        self.whole = true;
    }

    /// Takes away what `task` uses.
    pub(crate) fn narrow(&mut self, task: &OperationalSpace) {
        if self.whole {
            self.matrix.copy_from(&task.nullspace);
            self.whole = false;
            return;
        }
        self.before.copy_from(&self.matrix);
        multiply(&self.before, &task.nullspace, &mut self.matrix);
    }

    /// Adds Nᵀ `torque` to `sum`.
    pub(crate) fn add_torque(&self, torque: &[f64], sum: &mut [f64]) {
        for (out, column) in sum.iter_mut().zip(self.matrix.column_iter()) {
            *out += column.iter().zip(torque).map(|(n, t)| n * t).sum::<f64>();
        }
    }

    /// Adds N `velocity` to `sum`.
    pub(crate) fn add_velocity(&self, velocity: &[f64], sum: &mut [f64]) {
        for (v, column) in velocity.iter().zip(self.matrix.column_iter()) {
            for (out, n) in sum.iter_mut().zip(column.iter()) {
                *out += n * v;
            }
        }
    }
}

/// `a` `b`, square, without the packing buffer that nalgebra's product allocates.
fn multiply(a: &DMatrix<f64>, b: &DMatrix<f64>, out: &mut DMatrix<f64>) {
    out.fill(0.0);
    for (b_column, mut out_column) in b.column_iter().zip(out.column_iter_mut()) {
        for (a_column, factor) in a.column_iter().zip(b_column.iter()) {
            for (o, v) in out_column.iter_mut().zip(a_column.iter()) {
                *o += v * factor;
            }
        }
    }
}

/// One Cartesian task within the freedom that is left to it.
#[derive(Clone, Debug)]
pub(crate) struct ProjectedTask {
    /// J_p, scaled as the task's rows are.
    pub jacobian: Matrix6xX<f64>,
    pub space: OperationalSpace,
    column: DVector<f64>,
}

impl ProjectedTask {
    pub(crate) fn new(n: usize) -> Self {
        Self { jacobian: Matrix6xX::zeros(n), space: OperationalSpace::new(n), column: DVector::zeros(n) }
    }

    /// For the first `rows` rows of `jacobian`. The threshold is relative to what the task could move if
    /// nothing stood above it: what the tasks above have taken counts as lost, not as the new measure.
    pub(crate) fn update(
        &mut self,
        data: &Data,
        above: &Nullspace,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        threshold: f64,
    ) {
        if above.whole {
            self.jacobian.copy_from(jacobian);
            self.space.update(data, jacobian, rows, threshold);
            return;
        }
        for (k, mut out) in self.jacobian.column_iter_mut().enumerate() {
            out.fill(0.0);
            for (j, n) in jacobian.column_iter().zip(above.matrix.column(k).iter()) {
                out.axpy(*n, &j, 1.0);
            }
        }
        let alone = mobility(data, jacobian, rows, &mut self.column);
        let left = mobility(data, &self.jacobian, rows, &mut self.column);
        if left > 0.0 {
            self.space.update(data, &self.jacobian, rows, threshold * (alone / left).max(1.0));
        } else {
            self.jacobian.fill(0.0);
            self.space.update(data, &self.jacobian, rows, threshold);
        }
    }
}

/// The trace of J M⁻¹ Jᵀ.
fn mobility(data: &Data, jacobian: &Matrix6xX<f64>, rows: usize, column: &mut DVector<f64>) -> f64 {
    (0..rows)
        .map(|r| {
            column.tr_copy_from(&jacobian.row(r));
            cholesky_solve(&data.mass_matrix_factor, column.as_mut_slice());
            jacobian.row(r).iter().zip(column.iter()).map(|(j, c)| j * c).sum::<f64>()
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use opspace_model::{Frame, Inertia, Joint, JointKind, Limits, Model, Placement, frame_jacobian, update};

    /// A chain of links that are all alike, each turned against the one before.
    fn chain(n: usize) -> Model {
        let free = f64::INFINITY;
        let joints = (0..n).map(|i| Joint {
            name: format!("j{i}"),
            kind: JointKind::Continuous,
            parent: i.checked_sub(1),
            origin: Placement::from_rpy([1.1, 0.4, -0.3], [0.05, 0.02, 0.25]),
            inertia: Inertia {
                mass: 1.0,
                com: Vector3::new(0.02, 0.01, 0.1),
                rotational: Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.01)),
            },
            limits: Limits { lower: -free, upper: free, velocity: free, effort: free },
            rotor_inertia: 0.01,
        });
        let frame = |name: &str, joint| Frame {
            name: name.to_owned(),
            joint: Some(joint),
            placement: Placement::from_rpy([0.0; 3], [0.1, 0.0, 0.05]),
        };
        Model::new("chain".to_owned(), joints.collect(), vec![frame("middle", n / 2), frame("end", n - 1)])
    }

    /// J N against zero for every task so far, after each of three; and N M⁻¹ against its transpose, which
    /// is what makes Nᵀ project torques. Entries of J and N are of the order of 1.
    #[test]
    fn the_nullspace_moves_no_task_above_it() {
        let (n, tolerance) = (8, 1e-11);
        let model = chain(n);
        let mut data = Data::new(&model);
        let q: Vec<f64> = (0..n).map(|i| 0.4 * (1.0 + i as f64).sin()).collect();
        assert!(update(&model, &mut data, &q, &vec![0.0; n]));
        let mass_inverse = data.mass_matrix.clone().try_inverse().expect("M is regular");
        let rows_of = |name: &str, rows: std::ops::Range<usize>| {
            let mut j = Matrix6xX::zeros(n);
            frame_jacobian(&model, &data, model.frame(name).expect("frame"), &mut j);
            let mut selected = Matrix6xX::zeros(n);
            selected.rows_mut(0, rows.len()).copy_from(&j.rows(rows.start, rows.len()));
            (selected, rows.len())
        };
        let tasks = [rows_of("end", 0..3), rows_of("middle", 0..2), rows_of("end", 3..5)];
        let mut nullspace = Nullspace::new(n);
        let mut projected = ProjectedTask::new(n);
        for (level, (jacobian, rows)) in tasks.iter().enumerate() {
            projected.update(&data, &nullspace, jacobian, *rows, 1e-6);
            assert!(projected.space.weakest_share == 1.0, "level {level} is regular");
            nullspace.narrow(&projected.space);
            for (above, (jacobian, _)) in tasks[..=level].iter().enumerate() {
                let left = (jacobian * &nullspace.matrix).amax();
                assert!(left < tolerance, "below level {level}, level {above} still moves by {left}");
            }
            let product = &nullspace.matrix * &mass_inverse;
            assert!((&product - product.transpose()).amax() < tolerance * mass_inverse.amax());
        }
        let rank = nullspace.matrix.singular_values().iter().filter(|&&v| v > 1e-6).count();
        assert_eq!(rank, n - 7, "what is left of the joints' freedom");
    }
}
