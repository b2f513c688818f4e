//! The torque controller: tasks in strict priority, dynamically decoupled, within the robot's limits.
//!
//! ```text
//! F_i = Λ_p (a* − J̇ q̇ − J_i M⁻¹ τ_above) + F_compliant        τ = Σ J_pᵀ F_i + τ_joint + C q̇ + g
//! ```
//!
//! J_p = J_i N is the task Jacobian projected into the null space N of the tasks above; τ_joint is the task of all
//! joints, or damping of what the tasks leave. For rows that yield to forces (springs, compliant and force axes), only the
//! references of the tasks above count in τ_above: the acceleration with which a task above counters an external force
//! does not take place. Khatib 1987 for one task;
//! Sentis and Khatib, *Synthesis of whole-body behaviors through hierarchical control of behavioral primitives*, Int.
//! J. Humanoid Robotics 2(4), 2005, for several priority levels. If these torques are within the
//! [limits](crate::limits), they are the command. Otherwise each level is satisfied as closely as the limits and the
//! levels above allow.

use crate::algebra::multiply;
use crate::context::ControlContext;
use crate::controller::{CommandedAcceleration, ControlInput, Controller, StaleTarget};
use crate::error::ControlError;
use crate::hierarchy::contact_condition::ContactCondition;
use crate::hierarchy::priority_level::PriorityLevel;
use crate::hierarchy::task_parameters::{Compensation, TaskSetParameters};
use crate::hierarchy::task_schedule::{RecordedSignals, TaskSchedule};
use crate::hierarchy::task_set::TaskSet;
use crate::limiter::Limiter;
use crate::limits::joint_limits::LimitParameters;
use crate::prediction::Prediction;
use crate::qp::lexicographic::Solver;
use crate::qp::quadratic_program::QpError;
use crate::targets::Targets;
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::{Observable, SignalRecorder};
use opspace_model::{Data, Model};

/// Controller that converts tasks to joint torques.
pub struct OperationalSpaceController {
    schedule: TaskSchedule,
    context: ControlContext,
    compensation: Compensation,
    limiter: Option<Limiter>,
    /// Decrease of a task's error below which it comes to a standstill, m/s.
    standstill_below_m_per_s: f64,
    /// Present if commands act late by more than a short time.
    prediction: Option<Box<Prediction>>,
    /// Task torques, Nm or N (n).
    torque: DVector<f64>,
    joint_torque: DVector<f64>,
    scratch: DVector<f64>,
    /// Joint accelerations M⁻¹ τ that the task torques cause, rad/s² or m/s² (n).
    alpha: DVector<f64>,
    /// Intermediate value (n).
    added: DVector<f64>,
    /// Joint accelerations with which the levels follow their references, rad/s² or m/s² (n).
    intended: DVector<f64>,
    /// Compensation torques that are added to the task torques, Nm or N (n).
    compensation_torque: DVector<f64>,
    /// Last commanded torques, Nm or N (n).
    commanded: DVector<f64>,
    joint_names: Vec<String>,
}

impl OperationalSpaceController {
    /// Creates a controller for the tasks of a task file.
    ///
    /// # Errors
    /// Unknown names, axes that the robot cannot move, missing gains: see [`Reason`](crate::error::Reason).
    pub fn new(
        model: &Model,
        parameters: &TaskSetParameters<'_>,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        parameters.limits.check(context.period_s)?;
        let tasks = TaskSet::from_parameters(model, parameters, context, None)?;
        Ok(Self::from_tasks(model, tasks, context, parameters.compensation, &parameters.limits))
    }

    /// Creates a controller for tasks that are built in code. Values of `limits` out of range count as the nearest ones in
    /// their range.
    #[must_use]
    pub fn from_tasks(
        model: &Model,
        tasks: TaskSet,
        context: &ControlContext,
        compensation: Compensation,
        limits: &LimitParameters,
    ) -> Self {
        let zero = DVector::zeros(model.n());
        Self {
            schedule: TaskSchedule::new(tasks, RecordedSignals::Forces),
            context: context.clone(),
            compensation,
            prediction: Prediction::new(model, context).map(Box::new),
            standstill_below_m_per_s: limits.standstill_below_m_per_s.get(),
            limiter: limits.enforce.then(|| Limiter::new(model, limits, context)),
            torque: zero.clone(),
            joint_torque: zero.clone(),
            scratch: zero.clone(),
            alpha: zero.clone(),
            added: zero.clone(),
            intended: zero.clone(),
            compensation_torque: zero.clone(),
            commanded: zero,
            joint_names: model.joints().iter().map(|j| j.name.clone()).collect(),
        }
    }

    /// Builds another task set for the same robot, to be [switched](Self::switch) to during the run or
    /// [scheduled](Self::schedule). The compensation and limits of `parameters` are ignored: those of the first set
    /// remain.
    ///
    /// # Errors
    /// The errors of [`new`](Self::new); a task whose kind differs from that of the existing task of the same name.
    pub fn prepare(
        &self,
        model: &Model,
        parameters: &TaskSetParameters<'_>,
    ) -> Result<TaskSet, ControlError> {
        self.schedule.prepare(model, parameters, &self.context)
    }

    /// Checks that it is possible to switch to a task set built in code.
    ///
    /// # Errors
    /// A task whose kind or signals differ from those of the existing task of the same name.
    pub fn check(&self, tasks: &TaskSet) -> Result<(), ControlError> {
        self.schedule.check(tasks)
    }

    /// Replaces the active task set by `tasks`, which takes over its number, and returns the replaced set. A task
    /// continues from the task of the same name; the torque changes no faster than the torque rate limit allows.
    /// Allocates nothing. The log contains only tasks of the sets that were known when its signals were listed.
    pub fn switch(&mut self, tasks: TaskSet, input: &ControlInput<'_>) -> TaskSet {
        self.schedule.switch(tasks, input)
    }

    /// Schedules `tasks`: they become active at `time_s`, s after the start. The log contains them if they are
    /// scheduled before the start.
    pub fn schedule(&mut self, time_s: f64, tasks: TaskSet) {
        self.schedule.schedule(time_s, None, tasks);
    }

    /// Schedules `tasks` as [`schedule`](Self::schedule) does, for `time_s` or for a contact before this time. The
    /// contact counts when all sets that are scheduled for earlier times are or were active.
    pub fn schedule_at_contact(&mut self, time_s: f64, contact: ContactCondition, tasks: TaskSet) {
        self.schedule.schedule(time_s, Some(contact), tasks);
    }

    /// Adds a task set that can be activated by its number ([`Targets::choose_task_set`]) and returns the number. The
    /// first set has number 0; scheduled sets have numbers too. Call it before the start so that the log and the
    /// targets include its tasks.
    ///
    /// # Errors
    /// The errors of [`check`](Self::check).
    pub fn add_task_set(&mut self, tasks: TaskSet) -> Result<u32, ControlError> {
        self.schedule.add(tasks)
    }

    /// Number of the active task set.
    #[must_use]
    pub fn task_set(&self) -> usize {
        self.schedule.number()
    }

    /// The active task set.
    #[must_use]
    pub fn tasks(&self) -> &TaskSet {
        self.schedule.current()
    }

    /// Sets the last commanded torques to the ones that hold the arm still: the torque ramps up from them.
    fn hold_still(&mut self, data: &Data) {
        for (i, commanded) in self.commanded.iter_mut().enumerate() {
            *commanded = if self.context.gravity_by_robot { 0.0 } else { data.gravity[i] };
        }
        if let Some(prediction) = &mut self.prediction {
            prediction.restart();
        }
        if let Some(limiter) = &mut self.limiter {
            limiter.start();
        }
    }

    /// Returns true if a limit changed the last command.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.limiter.as_ref().is_some_and(|limiter| limiter.is_limited())
    }

    /// Solves the QPs of all levels even if no limit is active: tests and benchmarks compare both ways.
    #[doc(hidden)]
    pub fn always_solve(&mut self) {
        if let Some(limiter) = &mut self.limiter {
            limiter.always_solve();
        }
    }

    /// Makes the active-set method fail, with or without a second solver: for tests.
    #[doc(hidden)]
    pub fn fail_active_sets(&mut self, with_second_solver: bool) {
        if let Some(limiter) = &mut self.limiter {
            limiter.fail_active_sets(with_second_solver);
        }
    }

    /// Computes the task torques without limits.
    fn unlimited(&mut self, input: &ControlInput<'_>) {
        let data = input.data;
        let hierarchy = self.schedule.current_mut();
        self.torque.fill(0.0);
        self.intended.fill(0.0);
        hierarchy.nullspace.reset();
        let last = hierarchy.levels.len().saturating_sub(1);
        for place in 0..hierarchy.levels.len() {
            let (above, rest) = hierarchy.levels.split_at_mut(place);
            let Some(level) = rest.first_mut() else { break };
            level.update(input, above, &hierarchy.nullspace);
            if place == 0 {
                level.add_torque(None, self.torque.as_mut_slice());
            } else {
                level.set_reference_above(self.intended.as_slice());
                // M⁻¹ τ_above.
                self.scratch.copy_from(&self.torque);
                data.mass_matrix_factor.solve(self.scratch.as_mut_slice());
                level.add_torque(Some(self.scratch.as_slice()), self.torque.as_mut_slice());
            }
            if place < last {
                level.projected.compute_jbar(&data.mass_matrix_factor);
                level.add_reference_acceleration(self.intended.as_mut_slice());
                hierarchy.nullspace.push(&level.projected);
            }
        }
        let joint_input = hierarchy.joint_input(input);
        let (acceleration, torque) = (self.scratch.as_mut_slice(), self.joint_torque.as_mut_slice());
        let leaves_freedom = hierarchy.leaves_freedom(data.dq.len());
        match &mut hierarchy.joint {
            Some(task) => {
                task.update(&joint_input, acceleration, torque);
                let scratch = self.added.as_mut_slice();
                hierarchy.restrain_joints(data, self.context.period_s, acceleration, torque, scratch);
            }
            None if !leaves_freedom => return self.joint_torque.fill(0.0),
            // Without the velocity-dependent torques: they are compensated for the tasks, and motion that keeps them
            // conserves its energy.
            None => {
                let damping = hierarchy.unused_damping_per_s;
                acceleration.iter_mut().zip(&data.dq).for_each(|(a, v)| *a = -damping * v);
                multiply(&data.mass_matrix, acceleration, torque);
                if self.compensation == Compensation::Bias {
                    torque.iter_mut().zip(&data.bias).zip(&data.gravity).for_each(|((t, b), g)| *t -= b - g);
                    acceleration.copy_from_slice(torque);
                    data.mass_matrix_factor.solve(acceleration);
                }
            }
        }
        if let Some(level) = hierarchy.levels.last() {
            hierarchy.nullspace.project_above(&level.projected, acceleration, torque);
        }
        self.torque += &self.joint_torque;
    }

    /// Computes the compensation torques.
    fn compensate(&mut self, data: &Data) {
        let own = match self.compensation {
            Compensation::Bias => &data.bias,
            Compensation::Gravity => &data.gravity,
        };
        self.compensation_torque.copy_from(own);
        if self.context.gravity_by_robot {
            self.compensation_torque -= &data.gravity;
        }
    }

    /// Computes the task torques within the limits, and the compensation torques, at a state.
    fn compute(&mut self, input: &ControlInput<'_>) {
        self.schedule.advance(input);
        self.unlimited(input);
        self.compensate(input.data);
        self.limit(input);
        self.follow_standstills(input);
    }

    /// Lets tasks that are held back come to a standstill.
    fn follow_standstills(&mut self, input: &ControlInput<'_>) {
        let hierarchy = self.schedule.current_mut();
        if !hierarchy.levels.iter().any(PriorityLevel::is_observed) {
            return;
        }
        if self.limiter.is_none() {
            self.alpha.copy_from(&self.torque);
            input.data.mass_matrix_factor.solve(self.alpha.as_mut_slice());
        }
        let alpha = self.alpha.as_slice();
        hierarchy.follow_standstills(input, alpha, self.standstill_below_m_per_s, self.context.period_s);
    }

    /// Modifies the task torques where a limit requires it, and computes the joint accelerations that they cause, if limits
    /// are enforced.
    fn limit(&mut self, input: &ControlInput<'_>) {
        let data = input.data;
        let Some(limiter) = &mut self.limiter else {
            return;
        };
        self.alpha.copy_from(&self.torque);
        data.mass_matrix_factor.solve(self.alpha.as_mut_slice());
        let hierarchy = self.schedule.current_mut();
        limiter.update_state(input, self.compensation, hierarchy);
        let (alpha, torque, compensation_torque) = (&self.alpha, &self.torque, &self.compensation_torque);
        if limiter.is_strictly_feasible(input, &self.commanded, alpha, torque, compensation_torque) {
            for level in &mut hierarchy.levels {
                level.limited = false;
                level.held_back.release_resistance();
            }
            hierarchy.clear_slack(limiter.is_limited());
            limiter.record_status(Solver::Unlimited, alpha, torque, compensation_torque);
            if limiter.is_rehearsal_due() {
                hierarchy.complete_nullspace(data);
                self.scratch.copy_from(alpha);
                let scratch = &mut self.scratch;
                limiter.rehearse(input, &self.commanded, hierarchy, scratch, compensation_torque);
            }
            return;
        }
        limiter.demand(alpha);
        limiter.bound(input, &self.commanded);
        let (compensation_torque, scratch) = (&self.compensation_torque, &mut self.scratch);
        let solver = match limiter.solve(data, hierarchy, &self.joint_torque, compensation_torque, scratch) {
            Ok(solver) => {
                limiter.command_into(data, self.torque.as_mut_slice(), self.alpha.as_mut_slice());
                solver
            }
            Err(_) => Solver::Clipped,
        };
        if limiter.clip(&mut self.torque, &self.compensation_torque) {
            self.alpha.copy_from(&self.torque);
            data.mass_matrix_factor.solve(self.alpha.as_mut_slice());
        }
        limiter.set_slack(&self.alpha, self.schedule.current_mut());
        limiter.record_status(solver, &self.alpha, &self.torque, &self.compensation_torque);
    }
}

impl Controller for OperationalSpaceController {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn targets(&self) -> Targets {
        self.schedule.targets().clone()
    }

    fn unsolved_limits(&self) -> Option<QpError> {
        self.limiter.as_ref().and_then(Limiter::unsolved)
    }

    fn stale_target(&self) -> Option<StaleTarget> {
        self.schedule.current().0.stale_target()
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.schedule.start(input);
        self.hold_still(input.data);
    }

    fn reference_velocity(&mut self, input: &ControlInput<'_>, velocity: &mut [f64]) -> bool {
        self.schedule.current().0.reference_velocity(input, velocity, self.scratch.as_mut_slice());
        true
    }

    fn commanded_acceleration(&self) -> Option<CommandedAcceleration<'_>> {
        let limiter = self.limiter.as_ref()?;
        Some(CommandedAcceleration {
            acceleration: limiter.commanded_acceleration(),
            is_limited: limiter.is_limited(),
        })
    }

    fn observe_while_held(&mut self, input: &ControlInput<'_>) {
        self.schedule.advance(input);
        self.schedule.current_mut().observe(input);
    }

    fn resume(&mut self, input: &ControlInput<'_>) {
        self.schedule.advance(input);
        self.schedule.current_mut().resume(input);
        self.hold_still(input.data);
    }

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        let mut prediction = self.prediction.take();
        match prediction.as_mut().and_then(|prediction| prediction.of(input, &self.commanded)) {
            Some(predicted) => {
                self.compute(&predicted);
                self.schedule.current_mut().observe_measurement(input);
            }
            None => self.compute(input),
        }
        self.prediction = prediction;
        for ((out, torque), own) in command.iter_mut().zip(&self.torque).zip(&self.compensation_torque) {
            *out = torque + own;
        }
        self.commanded.copy_from_slice(command);
    }
}

impl Observable for OperationalSpaceController {
    fn record(&self, out: &mut SignalRecorder<'_>) {
        self.schedule.record(out);
        if let Some(limiter) = &self.limiter {
            limiter.record(&self.joint_names, out);
        }
    }
}
