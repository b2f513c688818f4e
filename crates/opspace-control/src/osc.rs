//! The torque controller: tasks in strict priority, dynamically decoupled, within the robot's limits.
//!
//! ```text
//! F_i = Λ_p (a* − J̇ q̇ − J_i M⁻¹ τ_above) + F_compliant        τ = Σ J_pᵀ F_i + τ_joint + C q̇ + g
//! ```
//!
//! J_p = J_i N is the task within the freedom N that the tasks above leave it. Khatib 1987 for one task;
//! Sentis and Khatib, *Synthesis of whole-body behaviors through hierarchical control of behavioral
//! primitives*, Int. J. Humanoid Robotics 2(4), 2005, for the levels. If these torques keep within the
//! [limits](crate::limits), they are the command; else each level comes as near to its own as the limits and the
//! levels above allow.

use crate::controller::Controller;
use crate::error::ControlError;
use crate::level::RowTask;
use crate::lexicographic::{Cascade, Limits, Residual, Solver, SpeedBound};
use crate::limits::{Bounds, HORIZON_S, Interval};
use crate::measurement::Measurement;
use crate::qp::QpError;
use crate::stacks::{PreparedStack, Shows, Stacks};
use crate::task::{Compensation, Levels, RobotFacts, Stack};
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::{Observable, Row, Signal};
use opspace_model::{Data, Model};

/// Tasks to torques.
pub struct OperationalSpaceController {
    stacks: Stacks,
    robot: RobotFacts,
    compensation: Compensation,
    limiter: Option<Limiter>,
    /// Of the tasks (n).
    torque: DVector<f64>,
    joint_torque: DVector<f64>,
    scratch: DVector<f64>,
    /// Commanded beside the tasks' torques (n).
    own_torque: DVector<f64>,
    /// What was commanded last (n).
    commanded: DVector<f64>,
    joint_names: Vec<String>,
}

/// What keeps commands within the limits.
struct Limiter {
    bounds: Bounds,
    /// Those on torques as they were before any of the bounds was widened.
    torque_bounds: Interval,
    cascade: Cascade,
    /// The first `speed_count` of them in force.
    speeds: Vec<SpeedBound>,
    speed_count: usize,
    /// What of the joints' acceleration doesn't come from the tasks (n).
    drift: DVector<f64>,
    /// Which bounds each joint's command stands at, as the sum of [`LIMITED_ACCELERATION`] and [`LIMITED_TORQUE`].
    limited: DVector<f64>,
    solver: Solver,
}

/// In the `limited` signal: the command stands at a bound of the joint's acceleration.
const LIMITED_ACCELERATION: f64 = 1.0;
/// In the `limited` signal: the command stands at a bound of the joint's torque or its rate.
const LIMITED_TORQUE: f64 = 2.0;

/// How near to a bound a command stands at it, relative to its size and 1: far more than what solvers leave.
const AT_BOUND: f64 = 1e-6;

/// Bounds on the speed of tasks at most: two for each of the first eight tasks.
const MAX_SPEED_BOUNDS: usize = 16;

impl OperationalSpaceController {
    /// The tasks of `stack` for a robot.
    ///
    /// # Errors
    /// Names that the robot doesn't have, axes that it can't move, gains that are missing: see
    /// [`Reason`](crate::error::Reason).
    pub fn new(model: &Model, stack: &Stack<'_>, robot: &RobotFacts) -> Result<Self, ControlError> {
        let n = model.n();
        let stacks = Stacks::new(model, stack, robot, Shows::Forces)?;
        let zero = DVector::zeros(n);
        let limiter = stack.limits.enforce.then(|| Limiter::new(model, stack, robot));
        Ok(Self {
            stacks,
            robot: robot.clone(),
            compensation: stack.compensation,
            limiter,
            torque: zero.clone(),
            joint_torque: zero.clone(),
            scratch: zero.clone(),
            own_torque: zero.clone(),
            commanded: zero,
            joint_names: model.joints().iter().map(|j| j.name.clone()).collect(),
        })
    }

    /// Another stack for the same robot, to be [switched](Self::switch) to while running or
    /// [scheduled](Self::schedule). Its compensation and limits aren't used: those of the first stack stay.
    ///
    /// # Errors
    /// As [`new`](Self::new), and a task that would change its kind.
    pub fn prepare(&self, model: &Model, stack: &Stack<'_>) -> Result<PreparedStack, ControlError> {
        self.stacks.prepare(model, stack, &self.robot)
    }

    /// Carries out `stack` from now on, and gives back the one that was carried out. Tasks of the same name go on from
    /// each other; the torque moves no faster than the robot's limit allows. Allocates nothing; only tasks that were
    /// there, or scheduled, when the signals were listed are in the log.
    pub fn switch(
        &mut self,
        stack: PreparedStack,
        model: &Model,
        data: &Data,
        measurement: &Measurement,
    ) -> PreparedStack {
        self.stacks.switch(stack, model, data, measurement)
    }

    /// Carries out `stack` from `time_s` on, s after the start. Scheduled before the start, its tasks are in the log.
    pub fn schedule(&mut self, time_s: f64, stack: PreparedStack) {
        self.stacks.schedule(time_s, stack);
    }

    /// Torque comes in from holding still.
    fn hold_still(&mut self, data: &Data) {
        for (i, commanded) in self.commanded.iter_mut().enumerate() {
            *commanded = if self.robot.gravity_by_robot { 0.0 } else { data.gravity[i] };
        }
    }

    /// Whether a limit changed the last command.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.limiter.as_ref().is_some_and(|limiter| limiter.solver != Solver::Unlimited)
    }

    /// Goes the long way even where no limit is in force: for tests and benches, which compare the two.
    #[doc(hidden)]
    pub fn without_shortcut(&mut self) {
        if let Some(limiter) = &mut self.limiter {
            limiter.cascade.without_shortcut();
        }
    }

    /// The tasks' torques as if there were no limits.
    fn unlimited(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        let levels = self.stacks.current();
        self.torque.fill(0.0);
        levels.nullspace.reset();
        let last = levels.rows.len().saturating_sub(1);
        for (place, level) in levels.rows.iter_mut().enumerate() {
            level.update(model, data, measurement, &levels.nullspace);
            if place == 0 {
                level.add_torque(None, self.torque.as_mut_slice());
            } else {
                // M⁻¹ τ_above.
                self.scratch.copy_from(&self.torque);
                data.mass_matrix_factor.solve(self.scratch.as_mut_slice());
                level.add_torque(Some(self.scratch.as_slice()), self.torque.as_mut_slice());
            }
            if place < last {
                level.projected.finish(&data.mass_matrix_factor);
                levels.nullspace.narrow(&level.projected);
            }
        }
        if let Some(task) = &mut levels.joint {
            let (acceleration, torque) = (self.scratch.as_mut_slice(), self.joint_torque.as_mut_slice());
            task.update(data, measurement.time_s, acceleration, torque);
            if let Some(level) = levels.rows.last() {
                levels.nullspace.project_above(&level.projected, acceleration, torque);
            }
            self.torque += &self.joint_torque;
        }
    }

    /// The arm's own torques that the controller takes away.
    fn compensate(&mut self, data: &Data) {
        let own = match self.compensation {
            Compensation::Bias => &data.bias,
            Compensation::Gravity => &data.gravity,
        };
        self.own_torque.copy_from(own);
        if self.robot.gravity_by_robot {
            self.own_torque -= &data.gravity;
        }
    }

    /// The tasks' torques, changed where a limit asks for it.
    fn limit(&mut self, data: &Data, measurement: &Measurement) {
        let Some(limiter) = &mut self.limiter else {
            return;
        };
        let levels = self.stacks.current();
        limiter.look(data, self.compensation, levels);
        self.scratch.copy_from(&self.torque);
        data.mass_matrix_factor.solve(self.scratch.as_mut_slice());
        let (alpha, torque, own_torque) = (&self.scratch, &self.torque, &self.own_torque);
        if limiter.plainly_allows(measurement, &self.commanded, alpha, torque, own_torque) {
            levels.rows.iter_mut().for_each(|level| level.limited = false);
            limiter.settle(Solver::Unlimited, alpha, torque, own_torque);
            return;
        }
        limiter.bound(measurement, &self.commanded);
        let (own_torque, scratch) = (&self.own_torque, &mut self.scratch);
        let solver = match limiter.solve(data, levels, &self.joint_torque, own_torque, scratch) {
            Ok(solver) => {
                limiter.cascade.torque_into(data, self.torque.as_mut_slice());
                solver
            }
            Err(_) => Solver::Clipped,
        };
        limiter.clip(&mut self.torque, &self.own_torque);
        self.scratch.copy_from(&self.torque);
        data.mass_matrix_factor.solve(self.scratch.as_mut_slice());
        limiter.settle(solver, &self.scratch, &self.torque, &self.own_torque);
    }
}

impl Limiter {
    fn new(model: &Model, stack: &Stack<'_>, robot: &RobotFacts) -> Self {
        let n = model.n();
        let zero = DVector::zeros(n);
        let limits = robot.limits.clone().narrowed(&stack.limits);
        let bounds = Bounds::new(model, limits, robot.period_s);
        Self {
            torque_bounds: bounds.torque.clone(),
            bounds,
            cascade: Cascade::new(n, MAX_SPEED_BOUNDS),
            speeds: vec![SpeedBound { row: zero.clone(), upper: f64::INFINITY }; MAX_SPEED_BOUNDS],
            speed_count: 0,
            drift: zero.clone(),
            limited: zero,
            solver: Solver::Unlimited,
        }
    }

    /// Takes in the state, but for the joints' bounds.
    fn look(&mut self, data: &Data, compensation: Compensation, levels: &Levels) {
        if compensation == Compensation::Gravity {
            for (drift, (gravity, bias)) in self.drift.iter_mut().zip(data.gravity.iter().zip(&data.bias)) {
                *drift = gravity - bias;
            }
            data.mass_matrix_factor.solve(self.drift.as_mut_slice());
        }
        self.speed_count = 0;
        for level in &levels.rows {
            let RowTask::Cartesian(task) = &level.task else { continue };
            for kind in 0..2 {
                let Some(slot) = self.speeds.get_mut(self.speed_count) else { return };
                if let Some(upper) = task.speed_bound(kind, level.bias(), slot.row.as_mut_slice()) {
                    slot.upper = upper - slot.row.dot(&self.drift);
                    self.speed_count += 1;
                }
            }
        }
    }

    /// Whether joint accelerations `alpha` (n), and the torques that cause them, can stay as they are after what was
    /// `commanded` before.
    fn plainly_allows(
        &self,
        measurement: &Measurement,
        commanded: &DVector<f64>,
        alpha: &DVector<f64>,
        torque: &DVector<f64>,
        own_torque: &DVector<f64>,
    ) -> bool {
        let acceleration = |i: usize| alpha[i] + self.drift[i];
        let torque = |i: usize| torque[i] + own_torque[i];
        self.cascade.has_shortcut()
            && self.bounds.plainly_allow(measurement, commanded, acceleration, torque)
            && self.speeds[..self.speed_count].iter().all(|speed| speed.allows(alpha.as_slice()))
    }

    /// The joints' bounds in this state, after what was `commanded` before.
    fn bound(&mut self, measurement: &Measurement, commanded: &DVector<f64>) {
        self.bounds.update(measurement, commanded);
        self.torque_bounds.lower.copy_from(&self.bounds.torque.lower);
        self.torque_bounds.upper.copy_from(&self.bounds.torque.upper);
    }

    /// Brings what each level asks for within the limits, by what the levels above leave free, and says who found it.
    /// `scratch` (n) is overwritten.
    ///
    /// # Errors
    /// At the first level for which no solver finds an answer. It and those below it count as limited.
    fn solve(
        &mut self,
        data: &Data,
        levels: &mut Levels,
        joint_torque: &DVector<f64>,
        own_torque: &DVector<f64>,
        scratch: &mut DVector<f64>,
    ) -> Result<Solver, QpError> {
        let (mut limits, cascade) = self.limits(own_torque);
        cascade.begin(data);
        // No command needed it before.
        if let Some(level) = levels.rows.last_mut() {
            level.projected.finish(&data.mass_matrix_factor);
            levels.nullspace.narrow(&level.projected);
        }
        levels.nullspace.rewind(0);
        levels.rows.iter_mut().for_each(|level| level.limited = true);
        for (place, level) in levels.rows.iter_mut().enumerate() {
            scratch.fill(0.0);
            level.add_torque(Some(cascade.alpha()), scratch.as_mut_slice());
            data.mass_matrix_factor.solve(scratch.as_mut_slice());
            cascade.ask(data, scratch.as_slice(), &mut limits);
            let heading = level.heading(data, cascade.alpha(), HORIZON_S);
            let projected = &level.projected;
            let inertia = &projected.space.task_inertia;
            let residual = Residual::Rows { jacobian: &projected.jacobian, inertia, heading };
            level.limited = cascade.keep_within(data, &levels.nullspace, &residual, &mut limits)?;
            levels.nullspace.rewind(place + 1);
        }
        scratch.fill(0.0);
        if levels.joint.is_some() {
            scratch.copy_from(joint_torque);
            data.mass_matrix_factor.solve(scratch.as_mut_slice());
        }
        cascade.ask(data, scratch.as_slice(), &mut limits);
        cascade.keep_within(data, &levels.nullspace, &Residual::Joints, &mut limits)?;
        Ok(cascade.solver())
    }

    fn limits<'a>(&'a mut self, own_torque: &'a DVector<f64>) -> (Limits<'a>, &'a mut Cascade) {
        let limits = Limits {
            bounds: &mut self.bounds,
            own_torque,
            drift: &self.drift,
            speeds: &mut self.speeds[..self.speed_count],
        };
        (limits, &mut self.cascade)
    }

    /// Cuts off torques beyond their limits: rounding, or what no solver could bring within them.
    fn clip(&self, torque: &mut DVector<f64>, own_torque: &DVector<f64>) {
        let Interval { lower, upper } = &self.torque_bounds;
        for (i, t) in torque.iter_mut().enumerate() {
            let commanded = *t + own_torque[i];
            // NaN passes: the backend refuses it by name.
            if commanded < lower[i] {
                *t = lower[i] - own_torque[i];
            } else if commanded > upper[i] {
                *t = upper[i] - own_torque[i];
            }
        }
    }

    /// Which bounds the command stands at.
    fn settle(
        &mut self,
        solver: Solver,
        alpha: &DVector<f64>,
        torque: &DVector<f64>,
        own_torque: &DVector<f64>,
    ) {
        self.solver = solver;
        if solver == Solver::Unlimited {
            self.limited.fill(0.0);
            return;
        }
        for i in 0..alpha.len() {
            let at = |interval: &Interval, value: f64| {
                let near = AT_BOUND * (1.0 + value.abs());
                value <= interval.lower[i] + near || value >= interval.upper[i] - near
            };
            let acceleration = at(&self.bounds.acceleration, alpha[i] + self.drift[i]);
            let torque = at(&self.bounds.torque, torque[i] + own_torque[i]);
            self.limited[i] = if acceleration { LIMITED_ACCELERATION } else { 0.0 }
                + if torque { LIMITED_TORQUE } else { 0.0 };
        }
    }
}

impl Controller for OperationalSpaceController {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn start(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        self.stacks.start(model, data, measurement);
        self.hold_still(data);
    }

    fn look_on(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        self.stacks.advance(model, data, measurement);
        self.stacks.current().observe(model, data, measurement);
    }

    fn resume(&mut self, model: &Model, data: &Data, measurement: &Measurement) {
        self.stacks.advance(model, data, measurement);
        self.stacks.current().resume(model, data, measurement);
        self.hold_still(data);
    }

    fn update(&mut self, model: &Model, data: &Data, measurement: &Measurement, command: &mut [f64]) {
        self.stacks.advance(model, data, measurement);
        self.unlimited(model, data, measurement);
        self.compensate(data);
        self.limit(data, measurement);
        for ((out, torque), own) in command.iter_mut().zip(&self.torque).zip(&self.own_torque) {
            *out = torque + own;
        }
        self.commanded.copy_from_slice(command);
    }
}

impl Observable for OperationalSpaceController {
    fn signals(&self) -> Vec<Signal> {
        let mut signals = self.stacks.signals();
        if self.limiter.is_some() {
            signals.push(Signal::new("limited", "1", &self.joint_names));
            signals.push(Signal::scalar("limits_solver", "1"));
        }
        signals
    }

    fn sample(&self, row: &mut Row<'_>) {
        self.stacks.sample(row);
        if let Some(limiter) = &self.limiter {
            row.put(limiter.limited.as_slice());
            row.put_one(f64::from(limiter.solver as u8));
        }
    }
}
