//! A task of at most six rows at its priority level: its projected inertia and its torques.

use crate::algebra::{add_transposed, product};
use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::hierarchy::escape::{Effect, EscapeInput};
use crate::hierarchy::held_back::HeldBack;
use crate::hierarchy::rank::TypicalMobility;
use crate::hierarchy::standstill::Outcome;
use crate::nullspace::{Nullspace, ProjectedTask};
use crate::qp::level_cost::Reducible;
use crate::qp::lexicographic::Residual;
use crate::targets::TargetPlace;
use crate::tasks::task::{SpeedLimit, Task, TaskInput, TaskSignals, clear_free_rows};
use crate::tasks::when_limited::WhenLimited;
use nalgebra::{DMatrix, Matrix6, Matrix6xX, Vector6};
use opspace_backend::SignalRecorder;
use opspace_model::{Data, Inversion, MassMatrixFactor, Model, OperationalSpace};

/// Gain of a damped inverse above which it differs from the exact one by rounding.
const WHOLE: f64 = 1.0 - 1e-9;

/// Speed below which a reference does not move, m/s or rad/s; far above what rounding leaves.
const STILL: f64 = 1e-6;

/// A priority level: a task with its quantities of the current cycle.
pub(crate) struct PriorityLevel {
    pub task: Box<dyn Task>,
    pub projected: ProjectedTask,
    bounded: Option<BoundedInertia>,
    /// Typical mobility of the task; the damping thresholds are relative to it.
    pub typical: TypicalMobility,
    /// Task Jacobian J (6 × n); unused rows are zero.
    jacobian: Matrix6xX<f64>,
    /// Desired acceleration a* − J̇ q̇ of the task's rows.
    desired: Vector6<f64>,
    /// J̇ q̇ of the task's rows.
    bias: Vector6<f64>,
    /// Acceleration of the rows that the references of the levels above cause.
    reference_above: Vector6<f64>,
    /// Commanded task force.
    force: Vector6<f64>,
    /// Weights of the rows' deviations when limits are in force; `None` if they are equal.
    weights: Option<Vector6<f64>>,
    when_limited: WhenLimited,
    /// Acceleration that limits took from the last command, in the layout of the task's signal.
    slack: Vec<f64>,
    /// True if a limit prevents the desired acceleration; the integrators of the task then stop.
    pub limited: bool,
    /// Escape, resistance and standstill of the task.
    pub held_back: HeldBack,
    /// Positions of the task's streamed inputs in the row of targets.
    pub target: TargetPlace,
}

/// Task inertia Λ of the arm with every diagonal entry of M raised to at least `floor` (kg m²).
struct BoundedInertia {
    floor: f64,
    mass_matrix: DMatrix<f64>,
    factor: MassMatrixFactor,
    space: OperationalSpace,
}

/// Groups of signals that a level, or a task of all joints, records together, in the order of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    Motion,
    Force,
    /// Acceleration that limits take.
    Slack,
    /// Acceleration of an escape from a singular pose.
    Escape,
    Gains,
    Sensed,
    Target,
}

impl PriorityLevel {
    /// Creates the level of `task`, of this typical mobility, below `above` levels.
    pub(crate) fn new(
        task: Box<dyn Task>,
        typical: TypicalMobility,
        model: &Model,
        context: &ControlContext,
        above: usize,
    ) -> Self {
        let n = model.n();
        let bounded = task.inertia_floor_kg_m2().map(|floor| BoundedInertia {
            floor,
            mass_matrix: DMatrix::zeros(n, n),
            factor: MassMatrixFactor::new(model),
            space: OperationalSpace::new(n),
        });
        let zero = Vector6::zeros();
        Self {
            weights: task.weights(),
            when_limited: task.when_limited(),
            held_back: HeldBack::new(&*task, model, context, above),
            slack: vec![0.0; task.slack_signal().len()],
            typical,
            task,
            projected: ProjectedTask::new(n),
            bounded,
            jacobian: Matrix6xX::zeros(n),
            desired: zero,
            bias: zero,
            reference_above: zero,
            force: zero,
            limited: false,
            target: TargetPlace::default(),
        }
    }

    pub(crate) fn name(&self) -> &str {
        self.task.name()
    }

    /// Task Jacobian J (6 × n) of the last update.
    pub(crate) fn jacobian(&self) -> &Matrix6xX<f64> {
        &self.jacobian
    }

    fn task_input<'a>(&self, control: &ControlInput<'a>, limited: bool) -> TaskInput<'a> {
        TaskInput { control: *control, limited, target: self.target.of(control.targets, control.clock_s) }
    }

    /// Updates state and reference in a cycle without torque command.
    pub(crate) fn observe(&mut self, input: &ControlInput<'_>) {
        self.task.observe(&self.task_input(input, true));
    }

    /// Updates state and reference to the time of the measurement, after an update with a predicted state.
    pub(crate) fn observe_measurement(&mut self, input: &ControlInput<'_>) {
        self.task.observe_measurement(&self.task_input(input, true));
    }

    /// Updates state, reference and sensed forces in a cycle of inverse kinematics.
    pub(crate) fn observe_with_forces(&mut self, input: &ControlInput<'_>) {
        self.task.observe_with_forces(&self.task_input(input, true));
    }

    /// Starts the task at the robot's present state.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        self.reset();
        self.task.start(input);
    }

    /// Blends from the state of `input.data`, at rest, into the task's reference.
    pub(crate) fn resume(&mut self, input: &ControlInput<'_>) {
        self.reset();
        self.task.resume(input);
    }

    /// Continues from the level of the same name in the previous task set.
    pub(crate) fn inherit(&mut self, before: &mut Self, input: &ControlInput<'_>) {
        self.reset();
        self.task.inherit(&mut *before.task, input);
    }

    /// Forgets the cycles before.
    fn reset(&mut self) {
        self.limited = false;
        self.held_back.reset();
    }

    /// Computes J at the state of `data`, and Λ in the null space of the tasks above, for any demand. The thresholds
    /// are relative to `typical`.
    pub(crate) fn project(&mut self, model: &Model, data: &Data, above: &Nullspace, typical: f64) {
        let (rows, inversion) = (self.task.rows(), self.task.inversion());
        self.task.jacobian(model, data, &mut self.jacobian);
        self.projected.project(above, &self.jacobian);
        self.projected.update(&data.mass_matrix_factor, rows, inversion, typical, None);
    }

    /// Computes all quantities of a cycle except the torques.
    /// `levels_above` are the levels above, and `above` their null space.
    pub(crate) fn update(&mut self, input: &ControlInput<'_>, levels_above: &[Self], above: &Nullspace) {
        let ControlInput { model, data, .. } = *input;
        self.task.update(&self.task_input(input, self.limited || self.held_back.standstill().acts()));
        let (rows, inversion, typical) = (self.task.rows(), self.task.inversion(), self.typical.dynamic);
        self.task.jacobian(model, data, &mut self.jacobian);
        self.bias = self.task.bias(model, data);
        self.desired = self.task.acceleration() - self.bias - self.held_back.standstill().taken();
        self.projected.project(above, &self.jacobian);
        self.projected.update(&data.mass_matrix_factor, rows, inversion, typical, Some(&self.desired));
        let effect = self.escape(input, levels_above, above);
        if effect == Effect::Ended {
            self.task.resume(input);
            self.desired = self.task.acceleration() - self.bias;
        }
        if effect != Effect::None {
            self.projected.update(&data.mass_matrix_factor, rows, inversion, typical, Some(&self.desired));
        }
        if let Some(bounded) = &mut self.bounded {
            bounded.update(data, &self.projected.jacobian, rows, inversion, typical, &self.desired);
        }
    }

    /// Updates the escape from a singular pose; returns its effect.
    fn escape(&mut self, input: &ControlInput<'_>, levels_above: &[Self], above: &Nullspace) -> Effect {
        if !self.held_back.can_escape() {
            return Effect::None;
        }
        // Also what a standstill takes.
        let desired = self.task.acceleration() - self.bias;
        let input = EscapeInput {
            model: input.model,
            data: input.data,
            time_s: input.measurement.time_s,
            task: &*self.task,
            desired,
            above,
            typical: self.typical.dynamic,
        };
        let tasks_above = levels_above.iter().map(|level| (&*level.task, level.typical.dynamic));
        self.held_back.update_escape(&input, tasks_above, &mut self.projected)
    }

    /// Acceleration that the rows demand, given the joint accelerations `above` (n; `None` for zero) that the levels above
    /// cause.
    ///
    /// A motion task counters an external force by an acceleration that does not take place. If a spring below it compensated
    /// for this acceleration, the force would deflect it by more than force over stiffness.
    fn demand(&self, above: Option<&[f64]>) -> Vector6<f64> {
        let mut demand = self.desired;
        if let Some(above) = above {
            let mut caused = product(&self.jacobian, above);
            for row in (0..self.task.rows()).filter(|row| self.task.yields_to_force(*row)) {
                caused[row] = self.reference_above[row];
            }
            demand -= caused;
        }
        self.held_back.replace_demand(&mut demand);
        demand
    }

    /// Stores the acceleration of the rows that the references of the levels above cause, given their joint accelerations
    /// `above` (n).
    pub(crate) fn set_reference_above(&mut self, above: &[f64]) {
        self.reference_above = product(&self.jacobian, above);
    }

    /// Adds the joint accelerations with which the rows follow their references to those of the levels above, `above` (n).
    /// J̄ is that of this cycle.
    pub(crate) fn add_reference_acceleration(&self, above: &mut [f64]) {
        let mut intended = self.task.reference_acceleration() - self.bias - self.reference_above;
        self.held_back.replace_demand(&mut intended);
        add_transposed(&self.projected.space.jbar_transpose, &intended, above);
    }

    /// Returns true if a direction of the task is damped for control.
    pub(crate) fn is_damped(&self) -> bool {
        self.projected.space.min_singular_gain < WHOLE && self.task.inversion().is_for_control()
    }

    /// Replaces the part of the joint accelerations `acceleration` (n) of a task below, and of its torques `torque` (n), that
    /// the damping of this level leaves to it: there, motion is braked (deceleration per velocity `damping_per_s`, 1/s). `scratch` (n) is
    /// overwritten.
    /// Otherwise, a task below would draw the arm away from the pose closest to a goal out of reach.
    pub(crate) fn brake_damped(
        &self,
        data: &Data,
        damping_per_s: f64,
        acceleration: &mut [f64],
        torque: &mut [f64],
        scratch: &mut [f64],
    ) {
        let mut change = Vector6::zeros();
        for ((column, a), v) in self.projected.jacobian.column_iter().zip(&*acceleration).zip(&data.dq) {
            change -= column * (damping_per_s * v + a);
        }
        let force = self.projected.space.damped_inertia * change;
        scratch.fill(0.0);
        add_transposed(&self.projected.jacobian, &force, scratch);
        torque.iter_mut().zip(&*scratch).for_each(|(t, x)| *t += x);
        data.mass_matrix_factor.solve(scratch);
        acceleration.iter_mut().zip(&*scratch).for_each(|(a, x)| *a += x);
    }

    /// Computes the task force, given the joint accelerations `above` (n; `None` for zero) that the levels above cause,
    /// and adds its joint torques to `torque` (n).
    pub(crate) fn add_torque(&mut self, above: Option<&[f64]>, torque: &mut [f64]) {
        let desired = self.demand(above);
        let inertia = &self.projected.space.task_inertia;
        let applied: &Matrix6<f64> = self.bounded.as_ref().map_or(inertia, |b| &b.space.task_inertia);
        let mut force = applied * desired;
        if let Some(mut added) = self.task.force(inertia) {
            self.held_back.remove_force(&mut added);
            self.task.set_added_force(&added);
            force += added;
        }
        self.force = force;
        add_transposed(&self.projected.jacobian, &force, torque);
    }

    /// Adds the joint velocities with which the rows follow their reference to `velocity` (n), those of the levels above.
    /// Rows without a reference stay at rest. `scratch` (n) is overwritten.
    pub(crate) fn add_reference_velocity(
        &self,
        input: &ControlInput<'_>,
        velocity: &mut [f64],
        scratch: &mut [f64],
    ) {
        let mut missing = self.task.kinematic_target(input.model, input.data, 0.0);
        clear_free_rows(&*self.task, &mut missing);
        missing -= product(&self.jacobian, velocity);
        let momentum = self.projected.space.task_inertia * missing;
        scratch.fill(0.0);
        add_transposed(&self.projected.jacobian, &momentum, scratch);
        input.data.mass_matrix_factor.solve(scratch);
        velocity.iter_mut().zip(&*scratch).for_each(|(v, x)| *v += x);
    }

    /// Predicted velocity of the task's rows after `horizon_s` (s) with the joint accelerations `ddq` (n).
    pub(crate) fn predicted_velocity(&self, data: &Data, ddq: &[f64], horizon_s: f64) -> Vector6<f64> {
        let mut velocity = self.bias * horizon_s;
        for ((column, &a), &v) in self.jacobian.column_iter().zip(ddq).zip(&data.dq) {
            velocity += column * (v + horizon_s * a);
        }
        velocity
    }

    /// Metric of the level's deviations, D Λ D with its weights D.
    pub(crate) fn metric(&self) -> Matrix6<f64> {
        let mut metric = self.projected.space.task_inertia;
        if let Some(weights) = &self.weights {
            for (mut column, of_column) in metric.column_iter_mut().zip(weights) {
                column.iter_mut().zip(weights).for_each(|(x, of_row)| *x *= of_row * of_column);
            }
        }
        metric
    }

    /// Residual of the level with its [metric](Self::metric), given the joint accelerations `ddq` (n) that it and the
    /// levels above demand.
    pub(crate) fn residual<'a>(
        &'a self,
        data: &Data,
        ddq: &[f64],
        metric: &'a Matrix6<f64>,
        horizon_s: f64,
    ) -> Residual<'a> {
        let jacobian = &self.projected.jacobian;
        let mut velocity = self.predicted_velocity(data, ddq, horizon_s);
        if self.when_limited != WhenLimited::Scaled {
            let resistance = self.held_back.resistance();
            return Residual::Rows { jacobian, inertia: metric, heading: velocity, resistance };
        }
        // The force on a compliant axis is no motion that could be slowed down.
        clear_free_rows(&*self.task, &mut velocity);
        Residual::ScaledRows { jacobian, inertia: metric, reducible: Reducible { velocity, horizon_s } }
    }

    /// Computes the passive arm that resists, given the joint accelerations `above` (n) that the levels above cause.
    pub(crate) fn update_resistance(&mut self, data: &Data, above: &[f64], period_s: f64) {
        if self.held_back.does_not_resist() {
            return;
        }
        let (demand, typical) = (self.demand(Some(above)), self.typical.dynamic);
        self.held_back.update_resistance(data, &self.projected, demand, typical, period_s);
    }

    /// Returns true if the reference of the task does not move.
    pub(crate) fn holds_reference(&self) -> bool {
        let speeds = self.task.reference_speeds();
        speeds.iter().any(Option::is_some) && speeds.iter().flatten().all(|speed| *speed < STILL)
    }

    /// Returns true if limits or the damping of a near singularity change the acceleration of the task, or did shortly
    /// before.
    pub(crate) fn is_observed(&self) -> bool {
        self.task.inversion().is_for_control()
            && !self.held_back.is_escaping()
            && (self.limited || self.is_damped() || !self.held_back.standstill().is_idle())
    }

    /// Lets the standstill follow a cycle, given the commanded joint accelerations `alpha` (n). Progress is a decrease of the
    /// error by more than `least_m_per_s` (m/s). `is_constant` is true if the references of this task and of those above do
    /// not move.
    pub(crate) fn follow_standstill(
        &mut self,
        input: &ControlInput<'_>,
        alpha: &[f64],
        is_constant: bool,
        least_m_per_s: f64,
        period_s: f64,
    ) {
        let mut error = if is_constant {
            self.task.kinematic_target(input.model, input.data, 1.0)
        } else {
            Vector6::zeros()
        };
        let mut outcome = Outcome {
            is_constant,
            is_held_back: self.limited || self.is_damped(),
            demand: self.task.acceleration(),
            commanded: product(&self.jacobian, alpha),
            velocity: product(&self.jacobian, input.data.dq.as_slice()),
            speed: input.data.dq.norm(),
        };
        let rows = [&mut error, &mut outcome.demand, &mut outcome.commanded, &mut outcome.velocity];
        rows.into_iter().for_each(|values| clear_free_rows(&*self.task, values));
        self.held_back.follow_standstill(&error, &outcome, least_m_per_s, period_s);
    }

    /// Stores what limits took from the rows, given the joint accelerations (n) that they took.
    pub(crate) fn set_slack(&mut self, taken: &[f64]) {
        let by_limits = product(&self.jacobian, taken);
        self.task.set_force_taken(&(self.projected.space.task_inertia * by_limits));
        let rows = by_limits + self.held_back.standstill().taken();
        self.task.spread_slack(&rows, &mut self.slack);
    }

    /// Bound `row` · α ≤ returned value on the joint accelerations α (n) that keeps the task's linear (`kind` 0) or
    /// angular (`kind` 1) speed within its limit after `horizon_s` (s); `None` while the speed is at most half of the
    /// limit.
    pub(crate) fn speed_bound(&self, kind: usize, horizon_s: f64, row: &mut [f64]) -> Option<f64> {
        let SpeedLimit { speed, limit, weights } = self.task.speed_limits()[kind]?;
        // Far below the limit, the direction of the velocity is ill-defined and no bound is needed.
        if speed.is_nan() || speed <= 0.5 * limit {
            return None;
        }
        row.fill(0.0);
        let mut upper = (limit - speed) / horizon_s;
        for (r, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            upper -= weight * self.bias[r];
            row.iter_mut().zip(self.jacobian.row(r).iter()).for_each(|(x, j)| *x += weight * j);
        }
        Some(upper)
    }

    /// Resets what limits took from the rows to what the standstill takes.
    pub(crate) fn clear_slack(&mut self) {
        self.slack.fill(0.0);
        if self.held_back.standstill().acts() {
            self.task.spread_slack(&self.held_back.standstill().taken(), &mut self.slack);
        }
    }

    /// Records a group of signals of the level.
    pub(crate) fn record(&self, group: Group, out: &mut SignalRecorder<'_>) {
        match group {
            Group::Motion => self.task.record(TaskSignals::Motion, out),
            // With the lowest gain of the damped inverse and the standstill.
            Group::Force => {
                let before = out.recorded();
                self.task.record(TaskSignals::Force(&self.force), out);
                if out.recorded() > before {
                    self.held_back.record(self.name(), self.projected.space.min_singular_gain, out);
                }
            }
            Group::Slack => out.signal_with(|| self.task.slack_signal(), &self.slack),
            Group::Escape => self.held_back.record_escape(self.name(), out),
            Group::Gains => self.task.record(TaskSignals::Gains, out),
            Group::Sensed => self.task.record(TaskSignals::Sensed, out),
            Group::Target => self.task.record(TaskSignals::Target, out),
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
        demand: &Vector6<f64>,
    ) {
        self.mass_matrix.copy_from(&data.mass_matrix);
        for i in 0..self.mass_matrix.ncols() {
            let entry = &mut self.mass_matrix[(i, i)];
            *entry = entry.max(self.floor);
        }
        // M with non-negative terms added to its diagonal is positive definite if M is.
        if self.factor.update(&self.mass_matrix) {
            // The typical mobility is scaled by the ratio of the mobilities.
            let [own, bounded] = [&data.mass_matrix_factor, &self.factor].map(|factor| {
                let half = &mut self.space.jbar_transpose;
                half.copy_from(jacobian);
                factor.mobility(half).trace()
            });
            let typical = if own > 0.0 { typical * bounded / own } else { typical };
            self.space.update_inertia(&self.factor, jacobian, rows, inversion, Some(typical), Some(demand));
        }
    }
}
