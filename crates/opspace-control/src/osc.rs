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

use crate::context::ControlContext;
use crate::controller::{ControlInput, Controller};
use crate::error::ControlError;
use crate::hierarchy::stacks::{PreparedStack, Shows, Stacks};
use crate::hierarchy::task::{Compensation, Stack};
use crate::limits::limiter::Limiter;
use crate::qp::lexicographic::Solver;
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::{Observable, Row, Signal};
use opspace_model::{Data, Model};

/// Tasks to torques.
pub struct OperationalSpaceController {
    stacks: Stacks,
    robot: ControlContext,
    compensation: Compensation,
    limiter: Option<Limiter>,
    /// Of the tasks (n).
    torque: DVector<f64>,
    joint_torque: DVector<f64>,
    scratch: DVector<f64>,
    /// Commanded beside the tasks' torques (n).
    compensation_torque: DVector<f64>,
    /// What was commanded last (n).
    commanded: DVector<f64>,
    joint_names: Vec<String>,
}

impl OperationalSpaceController {
    /// The tasks of `stack` for a robot.
    ///
    /// # Errors
    /// Names that the robot doesn't have, axes that it can't move, gains that are missing: see
    /// [`Reason`](crate::error::Reason).
    pub fn new(model: &Model, stack: &Stack<'_>, robot: &ControlContext) -> Result<Self, ControlError> {
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
            compensation_torque: zero.clone(),
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
    pub fn switch(&mut self, stack: PreparedStack, input: &ControlInput<'_>) -> PreparedStack {
        self.stacks.switch(stack, input)
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
        self.limiter.as_ref().is_some_and(|limiter| limiter.is_limited())
    }

    /// Goes the long way even where no limit is in force: for tests and benches, which compare the two.
    #[doc(hidden)]
    pub fn without_shortcut(&mut self) {
        if let Some(limiter) = &mut self.limiter {
            limiter.without_shortcut();
        }
    }

    /// The tasks' torques as if there were no limits.
    fn unlimited(&mut self, input: &ControlInput<'_>) {
        let ControlInput { data, measurement, .. } = *input;
        let levels = self.stacks.current();
        self.torque.fill(0.0);
        levels.nullspace.reset();
        let last = levels.rows.len().saturating_sub(1);
        for (place, level) in levels.rows.iter_mut().enumerate() {
            level.update(input, &levels.nullspace);
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
        self.compensation_torque.copy_from(own);
        if self.robot.gravity_by_robot {
            self.compensation_torque -= &data.gravity;
        }
    }

    /// The tasks' torques, changed where a limit asks for it.
    fn limit(&mut self, input: &ControlInput<'_>) {
        let data = input.data;
        let Some(limiter) = &mut self.limiter else {
            return;
        };
        let levels = self.stacks.current();
        limiter.update_state(data, self.compensation, levels);
        self.scratch.copy_from(&self.torque);
        data.mass_matrix_factor.solve(self.scratch.as_mut_slice());
        let (alpha, torque, compensation_torque) = (&self.scratch, &self.torque, &self.compensation_torque);
        if limiter.is_strictly_feasible(input, &self.commanded, alpha, torque, compensation_torque) {
            levels.rows.iter_mut().for_each(|level| level.limited = false);
            limiter.record_status(Solver::Unlimited, alpha, torque, compensation_torque);
            return;
        }
        limiter.bound(input, &self.commanded);
        let (compensation_torque, scratch) = (&self.compensation_torque, &mut self.scratch);
        let solver = match limiter.solve(data, levels, &self.joint_torque, compensation_torque, scratch) {
            Ok(solver) => {
                limiter.torque_into(data, self.torque.as_mut_slice());
                solver
            }
            Err(_) => Solver::Clipped,
        };
        limiter.clip(&mut self.torque, &self.compensation_torque);
        self.scratch.copy_from(&self.torque);
        data.mass_matrix_factor.solve(self.scratch.as_mut_slice());
        limiter.record_status(solver, &self.scratch, &self.torque, &self.compensation_torque);
    }
}

impl Controller for OperationalSpaceController {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Torque
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.stacks.start(input);
        self.hold_still(input.data);
    }

    fn observe_while_held(&mut self, input: &ControlInput<'_>) {
        self.stacks.advance(input);
        self.stacks.current().observe(input);
    }

    fn resume(&mut self, input: &ControlInput<'_>) {
        self.stacks.advance(input);
        self.stacks.current().resume(input);
        self.hold_still(input.data);
    }

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        self.stacks.advance(input);
        self.unlimited(input);
        self.compensate(input.data);
        self.limit(input);
        for ((out, torque), own) in command.iter_mut().zip(&self.torque).zip(&self.compensation_torque) {
            *out = torque + own;
        }
        self.commanded.copy_from_slice(command);
    }
}

impl Observable for OperationalSpaceController {
    fn signals(&self) -> Vec<Signal> {
        let mut signals = self.stacks.signals();
        if self.limiter.is_some() {
            signals.extend(Limiter::signals(&self.joint_names));
        }
        signals
    }

    fn sample(&self, row: &mut Row<'_>) {
        self.stacks.sample(row);
        if let Some(limiter) = &self.limiter {
            limiter.sample(row);
        }
    }
}
