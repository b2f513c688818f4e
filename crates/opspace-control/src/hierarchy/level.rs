//! A task with at most six rows, at its place in the hierarchy: its inertia there, and the torques it asks for.

use crate::controller::ControlInput;
use crate::hierarchy::nullspace::{Nullspace, ProjectedTask};
use crate::tasks::axes::AXIS_NAMES;
use crate::tasks::cartesian::CartesianTask;
use crate::tasks::cartesian_parameters::Decoupling;
use crate::tasks::joint::SelectedJoints;

use crate::hierarchy::products::{add_transposed, product};
use crate::hierarchy::rank::{Rows, TypicalMobility};
use nalgebra::{DMatrix, Matrix6, Matrix6xX, Vector6};
use opspace_backend::{Row, Signal};
use opspace_model::{Data, Inversion, MassMatrixFactor, Model, OperationalSpace};

/// What a level carries out.
#[derive(Clone, Debug)]
pub(crate) enum RowTask {
    Cartesian(Box<CartesianTask>),
    Joints(Box<SelectedJoints>),
}

impl RowTask {
    fn rank_rows(&self) -> Rows<'_> {
        match self {
            Self::Cartesian(task) => Rows::Axes(&task.axes),
            Self::Joints(task) => Rows::Joints(task.joints()),
        }
    }
}

/// A task among others.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    pub task: RowTask,
    pub projected: ProjectedTask,
    bounded: Option<BoundedInertia>,
    /// What thresholds of damping are relative to.
    pub typical: TypicalMobility,
    /// a* − J̇ q̇ of the task's rows, scaled.
    wanted: Vector6<f64>,
    /// J̇ q̇ of the task's rows, scaled.
    bias: Vector6<f64>,
    /// On the task's rows, scaled.
    force: Vector6<f64>,
    /// Whether a limit kept the level from what it asked for: its integrals then stand still.
    pub limited: bool,
}

/// Λ of an arm none of whose joints is lighter than a floor.
#[derive(Clone, Debug)]
struct BoundedInertia {
    floor: f64,
    mass_matrix: DMatrix<f64>,
    factor: MassMatrixFactor,
    space: OperationalSpace,
}

impl Level {
    pub(crate) fn new(task: RowTask, model: &Model) -> Self {
        let n = model.n();
        let bounded = match &task {
            RowTask::Cartesian(task) => match task.decoupling {
                Decoupling::Full => None,
                Decoupling::Bounded { inertia_floor_kg_m2 } => Some(BoundedInertia {
                    floor: inertia_floor_kg_m2.get(),
                    mass_matrix: DMatrix::zeros(n, n),
                    factor: MassMatrixFactor::new(model),
                    space: OperationalSpace::new(n),
                }),
            },
            RowTask::Joints(_) => None,
        };
        let zero = Vector6::zeros();
        let typical = TypicalMobility::new(model, &task.rank_rows());
        Self {
            typical,
            task,
            projected: ProjectedTask::new(n),
            bounded,
            limited: false,
            wanted: zero,
            bias: zero,
            force: zero,
        }
    }

    pub(crate) fn name(&self) -> &str {
        match &self.task {
            RowTask::Cartesian(task) => &task.name,
            RowTask::Joints(task) => task.name(),
        }
    }

    /// What the level's rows are, whatever the state.
    pub(crate) fn rank_rows(&self) -> Rows<'_> {
        self.task.rank_rows()
    }

    pub(crate) fn rows(&self) -> usize {
        self.rank_rows().count()
    }

    /// The rows of the task, scaled, as of the last update.
    pub(crate) fn jacobian(&self) -> &Matrix6xX<f64> {
        match &self.task {
            RowTask::Cartesian(task) => &task.jacobian,
            RowTask::Joints(task) => task.jacobian(),
        }
    }

    fn inversion(&self) -> Inversion {
        match &self.task {
            RowTask::Cartesian(task) => task.inversion,
            RowTask::Joints(_) => SelectedJoints::INVERSION,
        }
    }

    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, measurement, .. } = *input;
        match &mut self.task {
            RowTask::Cartesian(task) => task.start(model, data, measurement),
            RowTask::Joints(task) => task.start(measurement),
        }
    }

    /// Joins its reference from the state of `data`, at rest.
    pub(crate) fn resume(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, measurement, .. } = *input;
        self.limited = false;
        match &mut self.task {
            RowTask::Cartesian(task) => task.resume(model, data, measurement),
            RowTask::Joints(task) => task.resume(data.q.as_slice(), measurement.time_s),
        }
    }

    /// Goes on from where a level of the same name in another stack stands.
    pub(crate) fn take_over(&mut self, before: &mut Self, input: &ControlInput<'_>) {
        let ControlInput { model, data, measurement, .. } = *input;
        match (&mut self.task, &mut before.task) {
            (RowTask::Cartesian(task), RowTask::Cartesian(before)) => {
                task.take_over(before, model, data, measurement);
            }
            (RowTask::Joints(task), RowTask::Joints(before)) => task.take_over(before, measurement),
            (RowTask::Cartesian(_), RowTask::Joints(_)) | (RowTask::Joints(_), RowTask::Cartesian(_)) => {
                self.start(input);
            }
        }
    }

    /// Takes in where the robot is and where it should be, but not yet how hard it is to move.
    pub(crate) fn observe(&mut self, input: &ControlInput<'_>) {
        let ControlInput { model, data, measurement, .. } = *input;
        match &mut self.task {
            RowTask::Cartesian(task) => task.observe(model, data, measurement.time_s),
            RowTask::Joints(task) => task.observe(measurement.q.as_slice(), measurement.time_s),
        }
    }

    /// The task's rows at the state of `data`, and Λ within the freedom that is left above it; thresholds relative to
    /// `typical`.
    pub(crate) fn project(&mut self, model: &Model, data: &Data, above: &Nullspace, typical: f64) {
        if let RowTask::Cartesian(task) = &mut self.task {
            task.update_jacobian(model, data);
        }
        let (rows, inversion) = (self.rows(), self.inversion());
        let jacobian = match &self.task {
            RowTask::Cartesian(task) => &task.jacobian,
            RowTask::Joints(task) => task.jacobian(),
        };
        self.projected.update(&data.mass_matrix_factor, above, jacobian, rows, inversion, typical);
    }

    /// Everything of a tick but the torques: see [`observe`](Self::observe) and [`project`](Self::project), with
    /// integrals that stand still while a limit is in the way.
    pub(crate) fn update(&mut self, input: &ControlInput<'_>, above: &Nullspace) {
        let ControlInput { model, data, measurement, .. } = *input;
        self.observe(input);
        if let RowTask::Cartesian(task) = &mut self.task {
            task.sense(model, data, measurement, self.limited);
        }
        self.project(model, data, above, self.typical.dynamic);
        (self.wanted, self.bias) = match &self.task {
            RowTask::Cartesian(task) => {
                let bias = task.bias_acceleration(model, data);
                (task.acceleration() - bias, bias)
            }
            RowTask::Joints(task) => (task.acceleration(data), Vector6::zeros()),
        };
        let (rows, inversion) = (self.rows(), self.inversion());
        if let Some(bounded) = &mut self.bounded {
            bounded.update(data, &self.projected.jacobian, rows, inversion, self.typical.dynamic);
        }
    }

    /// The task's force if joint accelerations `above` (n; `None` for zero) are caused by the levels above it, and
    /// its joint torques added to `torque` (n).
    pub(crate) fn add_torque(&mut self, above: Option<&[f64]>, torque: &mut [f64]) {
        let mut wanted = self.wanted;
        if let Some(above) = above {
            wanted -= product(self.jacobian(), above);
        }
        let inertia = &self.projected.space.task_inertia;
        let applied: &Matrix6<f64> = self.bounded.as_ref().map_or(inertia, |b| &b.space.task_inertia);
        let mut force = applied * wanted;
        if let RowTask::Cartesian(task) = &self.task
            && task.adds_force()
        {
            force += task.added_force(inertia);
        }
        self.force = force;
        add_transposed(&self.projected.jacobian, &force, torque);
    }

    /// The velocity of the task's rows after `horizon_s` of joint accelerations `ddq` (n), scaled.
    pub(crate) fn heading(&self, data: &Data, ddq: &[f64], horizon_s: f64) -> Vector6<f64> {
        let mut heading = self.bias * horizon_s;
        for ((column, &a), &v) in self.jacobian().column_iter().zip(ddq).zip(&data.dq) {
            heading += column * (v + horizon_s * a);
        }
        heading
    }

    /// J̇ q̇ of the task's rows, scaled.
    pub(crate) fn bias(&self) -> &Vector6<f64> {
        &self.bias
    }

    /// Of the task's force, and what is left of it near a singularity.
    pub(crate) fn force_signals(&self) -> Vec<Signal> {
        match &self.task {
            RowTask::Cartesian(task) => vec![
                Signal::new(format!("{}.force", task.name), "N,Nm", &AXIS_NAMES),
                Signal::scalar(format!("{}.weakest_share", task.name), "1"),
            ],
            RowTask::Joints(_) => Vec::new(),
        }
    }

    pub(crate) fn sample_force(&self, row: &mut Row<'_>) {
        if let RowTask::Cartesian(task) = &self.task {
            row.put(task.axes.force_of_rows(&self.force).as_slice());
            row.put_one(self.projected.space.weakest_share);
        }
    }
}

impl BoundedInertia {
    fn update(
        &mut self,
        data: &Data,
        jacobian: &Matrix6xX<f64>,
        rows: usize,
        inversion: Inversion,
        typical: f64,
    ) {
        self.mass_matrix.copy_from(&data.mass_matrix);
        for i in 0..self.mass_matrix.ncols() {
            let entry = &mut self.mass_matrix[(i, i)];
            *entry = entry.max(self.floor);
        }
        // M plus what isn't negative on its diagonal is positive definite if M is.
        if self.factor.update(&self.mass_matrix) {
            // What is heavier is typically heavier.
            let [own, bounded] = [&data.mass_matrix_factor, &self.factor].map(|factor| {
                let half = &mut self.space.jbar_transpose;
                half.copy_from(jacobian);
                factor.mobility(half).trace()
            });
            let typical = if own > 0.0 { typical * bounded / own } else { typical };
            self.space.update_with(&self.factor, jacobian, rows, inversion, Some(typical));
        }
    }
}
