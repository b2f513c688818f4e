//! Enforcement of the limits: the task torques are modified where a limit requires it.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::hierarchy::task_hierarchy::TaskHierarchy;
use crate::hierarchy::task_parameters::Compensation;
use crate::limits::bounds::Bounds;
use crate::limits::collision_bounds::CollisionBounds;
use crate::limits::drag::Drag;
use crate::limits::joint_bound::Uncommanded;
use crate::limits::joint_limits::LimitParameters;
use crate::limits::push::Push;
use crate::qp::interval::Interval;
use crate::qp::lexicographic::{HierarchicalQp, Limits, Solver, SpeedBound};
use crate::qp::quadratic_program::QpError;
use nalgebra::DVector;
use opspace_backend::SignalRecorder;
use opspace_backend::signal_names::{LEAST_DISTANCE, LIMITED, LIMITS_SOLVER};
use opspace_model::{Data, Model};

/// Computation of commands within the limits.
pub(crate) struct Limiter {
    bounds: Bounds,
    push: Push,
    collision: Option<CollisionBounds>,
    /// Torque bounds before the QPs widen any of them.
    torque_bounds: Interval,
    cascade: HierarchicalQp,
    /// Bounds on task speeds, and on the approach of pairs if QPs are solved; only the first `speed_count` entries are
    /// in use.
    speeds: Vec<SpeedBound>,
    speed_count: usize,
    /// Joint acceleration that the tasks do not cause, rad/s² or m/s² (n).
    bias_acceleration: DVector<f64>,
    drag: Drag,
    /// Active bounds of each joint's command (n): sum of [`LIMITED_ACCELERATION`] and [`LIMITED_TORQUE`].
    limited: DVector<f64>,
    /// Time until the next rehearsal, s.
    rehearses_in_s: f64,
    /// Part of the next rehearsal.
    next_rehearsal: usize,
    /// True if the resistance of a level acts.
    resists: bool,
    solver: Solver,
    /// Joint accelerations that the tasks demand without limits, rad/s² or m/s² (n).
    demanded: DVector<f64>,
}

/// Value in the `limited` signal: an acceleration bound of the joint is active.
const LIMITED_ACCELERATION: f64 = 1.0;
/// Value in the `limited` signal: a bound of the joint's torque or torque rate is active.
const LIMITED_TORQUE: f64 = 2.0;

/// Time between two rehearsals while no limit is active, s.
const REHEARSAL_S: f64 = 0.1;

/// Tolerance within which a bound counts as active, relative to the command plus 1; far above the solvers' error.
const AT_BOUND: f64 = 1e-6;

impl Limiter {
    pub(crate) fn new(model: &Model, parameters: &LimitParameters, context: &ControlContext) -> Self {
        let n = model.n();
        let zero = DVector::zeros(n);
        let limits = context.limits.clone().narrowed(parameters);
        let bounds = Bounds::new(model, limits, context.period_s, parameters.horizon_s(context.period_s));
        let collision = context.collision.as_ref().map(|limits| CollisionBounds::new(model, limits, &bounds));
        // Each task has a row of its own and at most two speeds.
        let speeds = 2 * n + collision.as_ref().map_or(0, CollisionBounds::capacity);
        Self {
            collision,
            push: Push::new(n, context.period_s, bounds.horizon_s()),
            torque_bounds: bounds.torque.clone(),
            bounds,
            cascade: HierarchicalQp::new(n, speeds, parameters.lateral_weight()),
            speeds: vec![SpeedBound { row: zero.clone(), upper: f64::INFINITY }; speeds],
            speed_count: 0,
            bias_acceleration: zero.clone(),
            drag: Drag::new(n),
            limited: zero.clone(),
            rehearses_in_s: REHEARSAL_S,
            next_rehearsal: 0,
            resists: false,
            demanded: zero,
            solver: Solver::Unlimited,
        }
    }

    /// Forgets the motion before a start.
    pub(crate) fn start(&mut self) {
        self.push.reset();
        if let Some(collision) = &mut self.collision {
            collision.start();
        }
    }

    /// Updates all state-dependent quantities except the joint bounds.
    pub(crate) fn update_state(
        &mut self,
        input: &ControlInput<'_>,
        compensation: Compensation,
        hierarchy: &TaskHierarchy,
    ) {
        let ControlInput { model, data, .. } = *input;
        self.push.observe(&data.dq);
        self.cascade.clear_unsolved();
        if compensation == Compensation::Gravity {
            for (bias_acceleration, (gravity, bias)) in
                self.bias_acceleration.iter_mut().zip(data.gravity.iter().zip(&data.bias))
            {
                *bias_acceleration = gravity - bias;
            }
            data.mass_matrix_factor.solve(self.bias_acceleration.as_mut_slice());
        }
        self.drag.update(data, input.damping_torque);
        self.resists = hierarchy
            .levels
            .iter()
            .any(|level| !level.held_back.does_not_resist() || level.held_back.standstill().acts());
        if let Some(collision) = &mut self.collision {
            let uncommanded = Uncommanded { push: self.push.acceleration(), drag: &self.drag };
            collision.update(model, data, &self.bias_acceleration, uncommanded);
        }
        self.speed_count = 0;
        let horizon_s = self.bounds.horizon_s();
        for level in &hierarchy.levels {
            for kind in 0..2 {
                let Some(slot) = self.speeds.get_mut(self.speed_count) else { return };
                if let Some(upper) = level.speed_bound(kind, horizon_s, slot.row.as_mut_slice()) {
                    let [_, drag] = self.drag.along(slot.row.as_slice());
                    slot.upper = upper - slot.row.dot(&self.bias_acceleration) - drag;
                    self.speed_count += 1;
                }
            }
        }
    }

    /// Returns true if the joint accelerations `alpha` (n) and the torques that cause them need no modification.
    /// `commanded` are the last commanded torques (n).
    pub(crate) fn is_strictly_feasible(
        &self,
        input: &ControlInput<'_>,
        commanded: &DVector<f64>,
        alpha: &DVector<f64>,
        torque: &DVector<f64>,
        compensation_torque: &DVector<f64>,
    ) -> bool {
        let acceleration = |i: usize| alpha[i] + self.bias_acceleration[i];
        let torque = |i: usize| torque[i] + compensation_torque[i];
        self.cascade.has_shortcut()
            && !self.resists
            && self.bounds.is_strictly_feasible(
                input.measurement,
                self.drag.accelerations(),
                input.feedforward_torque,
                commanded,
                acceleration,
                torque,
            )
            && self.speeds[..self.speed_count]
                .iter()
                .chain(self.pairs())
                .all(|row| row.allows(alpha.as_slice()))
    }

    /// Bounds on the approach of pairs.
    fn pairs(&self) -> &[SpeedBound] {
        self.collision.as_ref().map_or(&[], CollisionBounds::rows)
    }

    /// Computes the joint bounds in this state; `commanded` are the last commanded torques (n).
    pub(crate) fn bound(&mut self, input: &ControlInput<'_>, commanded: &DVector<f64>) {
        let uncommanded = Uncommanded { push: self.push.acceleration(), drag: &self.drag };
        self.bounds.update(input.measurement, uncommanded, input.feedforward_torque, commanded);
        self.torque_bounds.lower.copy_from(&self.bounds.torque.lower);
        self.torque_bounds.upper.copy_from(&self.bounds.torque.upper);
        let pairs = self.collision.as_ref().map_or(&[][..], CollisionBounds::rows);
        for (slot, pair) in self.speeds[self.speed_count..].iter_mut().zip(pairs) {
            slot.row.copy_from(&pair.row);
            slot.upper = pair.upper;
            self.speed_count += 1;
        }
    }

    /// Solves the QPs of all levels: each level satisfies its desired accelerations as closely as the limits and the
    /// levels above allow. Returns the solver that was used. `scratch` (n) is overwritten.
    ///
    /// # Errors
    /// Fails at the first level that no solver can solve. This level and all levels below count as limited.
    pub(crate) fn solve(
        &mut self,
        data: &Data,
        hierarchy: &mut TaskHierarchy,
        joint_torque: &DVector<f64>,
        compensation_torque: &DVector<f64>,
        scratch: &mut DVector<f64>,
    ) -> Result<Solver, QpError> {
        let (horizon_s, period_s) = (self.bounds.horizon_s(), self.bounds.period_s());
        let (mut limits, cascade) = self.limits(compensation_torque);
        cascade.begin(data);
        hierarchy.complete_nullspace(data);
        hierarchy.nullspace.truncate(0);
        hierarchy.levels.iter_mut().for_each(|level| level.limited = true);
        for (place, level) in hierarchy.levels.iter_mut().enumerate() {
            scratch.fill(0.0);
            level.update_resistance(data, cascade.alpha(), period_s);
            level.add_torque(Some(cascade.alpha()), scratch.as_mut_slice());
            data.mass_matrix_factor.solve(scratch.as_mut_slice());
            cascade.add_demand(data, scratch.as_slice(), &mut limits);
            let metric = level.metric();
            let residual = level.residual(data, cascade.alpha(), &metric, horizon_s);
            level.limited = cascade.solve_level(data, &hierarchy.nullspace, &residual, &mut limits)?;
            level.held_back.follow_resistance(cascade.held(), level.typical.dynamic, period_s);
            hierarchy.nullspace.truncate(place + 1);
        }
        scratch.copy_from(joint_torque);
        data.mass_matrix_factor.solve(scratch.as_mut_slice());
        cascade.add_demand(data, scratch.as_slice(), &mut limits);
        if hierarchy.clips_joints() {
            cascade.clip_demand(&mut limits);
        }
        let residual = hierarchy.joint_residual(data, cascade.alpha(), horizon_s, scratch.as_mut_slice());
        cascade.solve_level(data, &hierarchy.nullspace, &residual, &mut limits)?;
        Ok(cascade.solver())
    }

    /// Returns true if a part is to be [rehearsed](Self::rehearse) in this cycle, whose command is within the limits.
    pub(crate) fn is_rehearsal_due(&mut self) -> bool {
        self.rehearses_in_s -= self.bounds.period_s();
        self.rehearses_in_s <= 0.0
    }

    /// Solves one of the QPs of a cycle at a limit, the next one each time, as if the torque of the first joint had to
    /// remain, and discards the result. The first cycle at a limit then finds code and data in the processor's cache:
    /// without, it takes four times as long as those after it. `alpha` (n), the joint accelerations, is overwritten.
    pub(crate) fn rehearse(
        &mut self,
        input: &ControlInput<'_>,
        commanded: &DVector<f64>,
        hierarchy: &mut TaskHierarchy,
        alpha: &mut DVector<f64>,
        compensation_torque: &DVector<f64>,
    ) {
        let (data, horizon_s, levels) = (input.data, self.bounds.horizon_s(), hierarchy.levels.len());
        // The levels, all joints, and the bounds that contradict each other.
        let part = self.next_rehearsal % (levels + 2);
        (self.next_rehearsal, self.rehearses_in_s) = (part + 1, REHEARSAL_S);
        self.bound(input, commanded);
        let Interval { lower, upper } = &mut self.bounds.torque;
        lower[0] = commanded[0].max(lower[0]).min(upper[0]);
        upper[0] = lower[0];
        let (mut limits, cascade) = self.limits(compensation_torque);
        let shortcut = cascade.replace_shortcut(false);
        cascade.begin(data);
        cascade.add_demand(data, alpha.as_slice(), &mut limits);
        hierarchy.nullspace.truncate(part.min(levels));
        // No command depends on the results.
        if let Some(level) = hierarchy.levels.get(part) {
            let metric = level.metric();
            let residual = level.residual(data, cascade.alpha(), &metric, horizon_s);
            let _ = cascade.solve_level(data, &hierarchy.nullspace, &residual, &mut limits);
        } else if part == levels {
            let residual = hierarchy.joint_residual(data, cascade.alpha(), horizon_s, alpha.as_mut_slice());
            let _ = cascade.solve_level(data, &hierarchy.nullspace, &residual, &mut limits);
        } else {
            let _ = cascade.relax_level(data, &hierarchy.nullspace, &mut limits);
        }
        cascade.replace_shortcut(shortcut);
        cascade.clear_unsolved();
    }

    fn limits<'a>(
        &'a mut self,
        compensation_torque: &'a DVector<f64>,
    ) -> (Limits<'a>, &'a mut HierarchicalQp) {
        let limits = Limits {
            acceleration: &mut self.bounds.acceleration,
            torque: &mut self.bounds.torque,
            compensation_torque,
            bias_acceleration: &self.bias_acceleration,
            speeds: &mut self.speeds[..self.speed_count],
        };
        (limits, &mut self.cascade)
    }

    /// Clips torques that exceed their limits, because of rounding or because no solver succeeded. Returns true if there
    /// were any.
    pub(crate) fn clip(&self, torque: &mut DVector<f64>, compensation_torque: &DVector<f64>) -> bool {
        let Interval { lower, upper } = &self.torque_bounds;
        let mut clipped = false;
        for (i, t) in torque.iter_mut().enumerate() {
            let commanded = *t + compensation_torque[i];
            // NaN is not clipped: the backend reports it.
            if commanded < lower[i] {
                *t = lower[i] - compensation_torque[i];
                clipped = true;
            } else if commanded > upper[i] {
                *t = upper[i] - compensation_torque[i];
                clipped = true;
            }
        }
        clipped
    }

    /// Stores the command and its active bounds: `alpha` are the joint accelerations that it causes (n).
    pub(crate) fn record_status(
        &mut self,
        solver: Solver,
        alpha: &DVector<f64>,
        torque: &DVector<f64>,
        compensation_torque: &DVector<f64>,
    ) {
        self.solver = solver;
        self.push.set_commanded(alpha, &self.bias_acceleration);
        if solver == Solver::Unlimited {
            self.limited.fill(0.0);
            return;
        }
        for i in 0..alpha.len() {
            let at = |interval: &Interval, value: f64| {
                let near = AT_BOUND * (1.0 + value.abs());
                value <= interval.lower[i] + near || value >= interval.upper[i] - near
            };
            let acceleration = at(&self.bounds.acceleration, alpha[i] + self.bias_acceleration[i]);
            let torque = at(&self.bounds.torque, torque[i] + compensation_torque[i]);
            self.limited[i] = if acceleration { LIMITED_ACCELERATION } else { 0.0 }
                + if torque { LIMITED_TORQUE } else { 0.0 };
        }
    }

    /// Stores the joint accelerations `alpha` (n) that the tasks demand without limits.
    pub(crate) fn demand(&mut self, alpha: &DVector<f64>) {
        self.demanded.copy_from(alpha);
    }

    /// Stores in each level what limits took from it, given the commanded joint accelerations `alpha` (n).
    pub(crate) fn set_slack(&mut self, alpha: &DVector<f64>, hierarchy: &mut TaskHierarchy) {
        self.demanded -= alpha;
        hierarchy.set_slack(self.demanded.as_mut_slice());
    }

    /// Joint accelerations that the last command causes (n; rad/s² or m/s²).
    pub(crate) fn commanded_acceleration(&self) -> &[f64] {
        self.push.commanded()
    }

    /// Returns true if a limit changed the last command.
    pub(crate) fn is_limited(&self) -> bool {
        self.solver != Solver::Unlimited
    }

    /// Solves the QPs even if no limit is active: tests and benchmarks compare both ways.
    pub(crate) fn always_solve(&mut self) {
        self.cascade.replace_shortcut(false);
    }

    /// Error of a program in the last cycle that no solver could correct, because the second one is not built in.
    pub(crate) fn unsolved(&self) -> Option<QpError> {
        self.cascade.unsolved()
    }

    /// Makes the active-set method fail, with or without a second solver: for tests.
    pub(crate) fn fail_active_sets(&mut self, with_second_solver: bool) {
        self.cascade.fail_active_sets(with_second_solver);
    }

    /// Writes the torques computed by [`solve`](Self::solve) and the joint accelerations that they cause (n each).
    pub(crate) fn command_into(&self, data: &Data, torque: &mut [f64], alpha: &mut [f64]) {
        self.cascade.torque_into(data, torque);
        alpha.copy_from_slice(self.cascade.alpha());
    }

    /// Records which bounds are active at each joint, and which solver computed the command.
    pub(crate) fn record(&self, joint_names: &[String], out: &mut SignalRecorder<'_>) {
        out.signal(LIMITED, "1", joint_names, self.limited.as_slice());
        out.scalar(LIMITS_SOLVER, "1", f64::from(self.solver as u8));
        if let Some(collision) = &self.collision {
            out.scalar(LEAST_DISTANCE, "m", collision.least_m());
        }
    }
}
