//! Feasibility of tasks: the rank of their axes over sampled configurations, and their typical mobility.

use crate::nullspace::{Nullspace, ProjectedTask};
use crate::tasks::task::Task;
use nalgebra::{DMatrix, Matrix6xX, SymmetricEigen};
use opspace_model::{Data, Inversion, Model, Postures, kinematics, update};

/// Singular values below this fraction of the largest one count as zero. The value is far above rounding errors and far
/// below the singular values of an axis that the arm can move, in its best configuration.
const RANK_TOLERANCE: f64 = 1e-6;

/// Number of sampled configurations. An arm is rank-deficient either in every configuration or in almost none: one
/// generic sample is enough to show full rank.
const SAMPLES: usize = 64;

/// Returns the highest rank of the tasks' stacked rows over configurations distributed within the joint limits.
#[must_use]
pub fn sampled_rank(model: &Model, tasks: &[&dyn Task]) -> usize {
    let (n, rows) = (model.n(), tasks.iter().map(|task| task.rows()).sum::<usize>());
    let (mut data, mut jacobian) = (Data::new(model), Matrix6xX::zeros(n));
    let mut stacked = DMatrix::zeros(rows, n);
    let (postures, rest) = (Postures::new(model, 1.0), vec![0.0; n]);
    let mut best = 0;
    for sample in 0..SAMPLES {
        kinematics(model, &mut data, &postures.posture(sample), &rest);
        let mut first = 0;
        for task in tasks {
            task.sampled_jacobian(model, &data, &mut jacobian);
            stacked.rows_mut(first, task.rows()).copy_from(&jacobian.rows(0, task.rows()));
            first += task.rows();
        }
        best = best.max(rank(&stacked));
        if best == rows.min(n) {
            break;
        }
    }
    best
}

/// Returns true if two lists of tasks have the same rows in all configurations in which rank and typical mobility are sampled:
/// then these are the same too. This takes a tenth of the time of computing them.
pub(crate) fn have_same_rows(model: &Model, tasks: &[&dyn Task], others: &[&dyn Task]) -> bool {
    let pairs = || tasks.iter().zip(others);
    if tasks.len() != others.len() || pairs().any(|(task, other)| task.rows() != other.rows()) {
        return false;
    }
    let (mut data, rest) = (Data::new(model), vec![0.0; model.n()]);
    let (mut rows, mut other_rows) = (Matrix6xX::zeros(model.n()), Matrix6xX::zeros(model.n()));
    let postures = Postures::new(model, 1.0);
    (0..SAMPLES).all(|sample| {
        // As for the typical mobility, a posture without dynamics does not count.
        !update(model, &mut data, &postures.posture(sample), &rest)
            || pairs().all(|(task, other)| {
                task.sampled_jacobian(model, &data, &mut rows);
                other.sampled_jacobian(model, &data, &mut other_rows);
                rows.rows(0, task.rows()) == other_rows.rows(0, task.rows())
            })
    })
}

/// Typical mobility of a task: the median, over many postures, of the smallest eigenvalue of Λ⁻¹ = J_p M⁻¹ J_pᵀ, with
/// J_p = J N in the null space of the tasks above. A direction with a much lower mobility is close to singular; this
/// holds for any masses of the arm and units of the task.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct TypicalMobility {
    /// Mobility with the arm's M, 1/kg.
    pub dynamic: f64,
    /// Mobility with the identity instead of M, from J_p J_pᵀ.
    pub kinematic: f64,
}

impl TypicalMobility {
    /// Computes the typical mobility of a task's rows below the tasks `above`, which are in order of priority.
    #[must_use]
    pub fn new<'a>(model: &Model, above: impl Iterator<Item = &'a dyn Task>, task: &dyn Task) -> Self {
        let n = model.n();
        let above: Vec<&dyn Task> = above.collect();
        let mut data = Data::new(model);
        let identity = {
            let mut factor = data.mass_matrix_factor.clone();
            factor.set_identity();
            factor
        };
        let mut nullspace = Nullspace::new(n, above.len());
        let (mut jacobian, mut projected) = (Matrix6xX::zeros(n), ProjectedTask::new(n));
        let postures = Postures::new(model, 1.0);
        let (mut dynamic, mut kinematic) = (Vec::with_capacity(SAMPLES), Vec::with_capacity(SAMPLES));
        for sample in 0..SAMPLES {
            if !update(model, &mut data, &postures.posture(sample), &vec![0.0; n]) {
                continue;
            }
            for (of, factor) in [(&mut dynamic, &data.mass_matrix_factor), (&mut kinematic, &identity)] {
                nullspace.reset();
                for task in &above {
                    task.sampled_jacobian(model, &data, &mut jacobian);
                    // Plain: exact wherever the directions of the tasks above are independent.
                    projected.project(&nullspace, &jacobian);
                    projected.update(factor, task.rows(), Inversion::Plain, 1.0, None);
                    projected.compute_jbar(factor);
                    nullspace.push(&projected);
                }
                task.sampled_jacobian(model, &data, &mut jacobian);
                projected.project(&nullspace, &jacobian);
                let mobility = factor.mobility(&mut projected.jacobian);
                let used = mobility.view((0, 0), (task.rows(), task.rows())).into_owned();
                let spectrum = SymmetricEigen::try_new(used, f64::EPSILON, MAX_ITERATIONS);
                of.extend(spectrum.map(|spectrum| spectrum.eigenvalues.min()));
            }
        }
        let [dynamic, kinematic] = [dynamic, kinematic].map(|mut values| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.0).max(0.0)
        });
        Self { dynamic, kinematic }
    }
}

/// Largest number of iterations of a decomposition: finite matrices of our sizes need some ten per row.
const MAX_ITERATIONS: usize = 1000;

fn rank(matrix: &DMatrix<f64>) -> usize {
    if matrix.is_empty() {
        return 0;
    }
    // A matrix that is not finite has no rank.
    let decomposed = matrix.clone().try_svd_unordered(false, false, f64::EPSILON, MAX_ITERATIONS);
    let Some(values) = decomposed.map(|decomposed| decomposed.singular_values) else { return 0 };
    let floor = RANK_TOLERANCE * values.max();
    values.iter().filter(|&&v| v > floor).count()
}
