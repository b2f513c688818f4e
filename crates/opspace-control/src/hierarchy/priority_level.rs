//! A task of at most six rows at its place in the priority: its inertia there, and its torques.

use crate::controller::ControlInput;
use crate::hierarchy::nullspace::{Nullspace, ProjectedTask};
use crate::hierarchy::products::{add_transposed, product};
use crate::hierarchy::rank::TypicalMobility;
use crate::limits::bounds::HORIZON_S;
use crate::targets::TargetPlace;
use crate::tasks::task::{SpeedLimit, Task, TaskInput};
use nalgebra::{DMatrix, Matrix6, Matrix6xX, Vector6};
use opspace_backend::SignalRecorder;
use opspace_backend::signal_names::MIN_SINGULAR_GAIN;
use opspace_model::{Data, Inversion, MassMatrixFactor, Model, OperationalSpace};

/// A task among others.
pub(crate) struct PriorityLevel {
    pub task: Box<dyn Task>,
    pub projected: ProjectedTask,
    bounded: Option<BoundedInertia>,
    /// Typical mobility, to which the damping thresholds are relative.
    pub typical: TypicalMobility,
    /// J of the task's rows; zeros below them.
    jacobian: Matrix6xX<f64>,
    /// a* − J̇ q̇ of the task's rows.
    desired: Vector6<f64>,
    /// J̇ q̇ of the task's rows.
    bias: Vector6<f64>,
    /// Force on the task's rows.
    force: Vector6<f64>,
    /// A limit kept the level from its acceleration: its integrals then stand still.
    pub limited: bool,
    /// Places of the task's streamed inputs.
    pub target: TargetPlace,
}

/// Λ of an arm none of whose joints is lighter than a floor.
struct BoundedInertia {
    floor: f64,
    mass_matrix: DMatrix<f64>,
    factor: MassMatrixFactor,
    space: OperationalSpace,
}

impl PriorityLevel {
    pub(crate) fn new(task: Box<dyn Task>, model: &Model) -> Self {
        let n = model.n();
        let bounded = task.inertia_floor_kg_m2().map(|floor| BoundedInertia {
            floor,
            mass_matrix: DMatrix::zeros(n, n),
            factor: MassMatrixFactor::new(model),
            space: OperationalSpace::new(n),
        });
        let zero = Vector6::zeros();
        Self {
            typical: TypicalMobility::new(model, &*task),
            task,
            projected: ProjectedTask::new(n),
            bounded,
            jacobian: Matrix6xX::zeros(n),
            desired: zero,
            bias: zero,
            force: zero,
            limited: false,
            target: TargetPlace::default(),
        }
    }

    pub(crate) fn name(&self) -> &str {
        self.task.name()
    }

    /// J of the task's rows, as of the last update.
    pub(crate) fn jacobian(&self) -> &Matrix6xX<f64> {
        &self.jacobian
    }

    fn task_input<'a>(&self, control: &ControlInput<'a>, limited: bool) -> TaskInput<'a> {
        TaskInput { control: *control, limited, target: self.target.of(control.targets, control.clock_s) }
    }

    /// Takes in state and reference, in a cycle without torques.
    pub(crate) fn observe(&mut self, input: &ControlInput<'_>) {
        self.task.observe(&self.task_input(input, true));
    }

    /// Joins its reference from the state of `input.data`, at rest.
    pub(crate) fn resume(&mut self, input: &ControlInput<'_>) {
        self.limited = false;
        self.task.resume(input);
    }

    /// Computes J at the state of `data`, and Λ within the freedom that is left above; thresholds are relative to
    /// `typical`.
    pub(crate) fn project(&mut self, model: &Model, data: &Data, above: &Nullspace, typical: f64) {
        let rows = self.task.rows();
        self.task.jacobian(model, data, &mut self.jacobian);
        let inversion = self.task.inversion();
        self.projected.update(&data.mass_matrix_factor, above, &self.jacobian, rows, inversion, typical);
    }

    /// Computes everything of a cycle but the torques.
    pub(crate) fn update(&mut self, input: &ControlInput<'_>, above: &Nullspace) {
        let ControlInput { model, data, .. } = *input;
        self.task.update(&self.task_input(input, self.limited));
        self.project(model, data, above, self.typical.dynamic);
        self.bias = self.task.bias(model, data);
        self.desired = self.task.acceleration() - self.bias;
        let (rows, inversion) = (self.task.rows(), self.task.inversion());
        if let Some(bounded) = &mut self.bounded {
            bounded.update(data, &self.projected.jacobian, rows, inversion, self.typical.dynamic);
        }
    }

    /// Computes the task's force if joint accelerations `above` (n; `None` for zero) are caused by the levels above it,
    /// and adds its joint torques to `torque` (n).
    pub(crate) fn add_torque(&mut self, above: Option<&[f64]>, torque: &mut [f64]) {
        let mut desired = self.desired;
        if let Some(above) = above {
            desired -= product(&self.jacobian, above);
        }
        let inertia = &self.projected.space.task_inertia;
        let applied: &Matrix6<f64> = self.bounded.as_ref().map_or(inertia, |b| &b.space.task_inertia);
        let mut force = applied * desired;
        if let Some(added) = self.task.force(inertia) {
            force += added;
        }
        self.force = force;
        add_transposed(&self.projected.jacobian, &force, torque);
    }

    /// Velocity of the task's rows after `horizon_s` of joint accelerations `ddq` (n).
    pub(crate) fn predicted_velocity(&self, data: &Data, ddq: &[f64], horizon_s: f64) -> Vector6<f64> {
        let mut velocity = self.bias * horizon_s;
        for ((column, &a), &v) in self.jacobian.column_iter().zip(ddq).zip(&data.dq) {
            velocity += column * (v + horizon_s * a);
        }
        velocity
    }

    /// The bound that keeps the task's linear (`kind` 0) or angular (1) speed within its limit, where it comes near it:
    /// `row` (n) α ≤ the value, with α the joint accelerations.
    pub(crate) fn speed_bound(&self, kind: usize, row: &mut [f64]) -> Option<f64> {
        let SpeedLimit { speed, limit, weights } = self.task.speed_limits()[kind]?;
        // Far below its limit a speed has hardly a direction, and no need of a bound.
        if speed.is_nan() || speed <= 0.5 * limit {
            return None;
        }
        row.fill(0.0);
        let mut upper = (limit - speed) / HORIZON_S;
        for (r, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            upper -= weight * self.bias[r];
            row.iter_mut().zip(self.jacobian.row(r).iter()).for_each(|(x, j)| *x += weight * j);
        }
        Some(upper)
    }

    /// Records the task's force, if it has such a signal, and the lowest gain of its damped inverse.
    pub(crate) fn record_force(&self, out: &mut SignalRecorder<'_>) {
        let before = out.recorded();
        self.task.record_force(&self.force, out);
        if out.recorded() > before {
            out.scalar((self.name(), MIN_SINGULAR_GAIN), "1", self.projected.space.min_singular_gain);
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
