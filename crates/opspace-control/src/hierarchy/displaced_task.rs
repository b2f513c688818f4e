//! Task at another pose of the arm than the present one, at rest.

use crate::algebra::{add_transposed, product};
use crate::nullspace::{Nullspace, ProjectedTask};
use crate::tasks::task::Task;
use nalgebra::{DVector, Matrix6xX, Vector6};
use opspace_model::{Data, Model, update};

/// Part of the errors of the tasks above that [`DisplacedTask::correction`] corrects.
pub(crate) const CORRECTED: f64 = 0.5;

/// A task at a displaced pose, below the tasks above.
pub(crate) struct DisplacedTask {
    /// Pose, at rest.
    pub data: Data,
    pub above: Nullspace,
    /// Task with its J_p; its other quantities are those of the last task above.
    pub projected: ProjectedTask,
    /// J (6 × n).
    pub jacobian: Matrix6xX<f64>,
    /// Joint motion that reduces the errors of the tasks above, rad or m (n).
    pub correction: DVector<f64>,
    at_rest: DVector<f64>,
}

impl DisplacedTask {
    /// Allocates the quantities of a task below `above` tasks.
    pub(crate) fn new(model: &Model, above: usize) -> Self {
        let n = model.n();
        Self {
            data: Data::new(model),
            above: Nullspace::new(n, above),
            projected: ProjectedTask::new(n),
            jacobian: Matrix6xX::zeros(n),
            correction: DVector::zeros(n),
            at_rest: DVector::zeros(n),
        }
    }

    /// Computes all quantities at the joint positions `q` (n); `tasks_above` are the tasks above, in order of priority, with
    /// their typical mobilities. Returns false if the arm has no dynamics there.
    pub(crate) fn displace<'a>(
        &mut self,
        model: &Model,
        task: &dyn Task,
        tasks_above: impl Iterator<Item = (&'a dyn Task, f64)>,
        q: &[f64],
    ) -> bool {
        if !update(model, &mut self.data, q, self.at_rest.as_slice()) {
            return false;
        }
        let factor = &self.data.mass_matrix_factor;
        self.above.reset();
        self.correction.fill(0.0);
        for (task, typical) in tasks_above {
            task.jacobian(model, &self.data, &mut self.jacobian);
            self.projected.project(&self.above, &self.jacobian);
            let (rows, demand) = (task.rows(), Vector6::zeros());
            self.projected.update(factor, rows, task.inversion(), typical, Some(&demand));
            self.projected.compute_jbar(factor);
            let mut error = error(model, &self.data, task) * CORRECTED;
            error -= product(&self.jacobian, self.correction.as_slice());
            let inverse = &self.projected.space.jbar_transpose;
            add_transposed(inverse, &error, self.correction.as_mut_slice());
            self.above.push(&self.projected);
        }
        task.jacobian(model, &self.data, &mut self.jacobian);
        self.projected.project(&self.above, &self.jacobian);
        true
    }
}

/// Returns the error x_d − x of the rows that follow a reference, with x at the state of `data`; 0 for other rows.
pub(crate) fn error(model: &Model, data: &Data, task: &dyn Task) -> Vector6<f64> {
    let mut error = task.kinematic_target(model, data, 1.0) - task.kinematic_target(model, data, 0.0);
    for (row, error) in error.iter_mut().enumerate() {
        if !task.follows_reference(row) {
            *error = 0.0;
        }
    }
    error
}
