//! Inverse kinematics, streamed as joint positions: the baseline without torque control.
//!
//! ```text
//! q̇_ref = J⁺ (ẋ_d + 20 (x_d − x(q_ref))) + (I − J⁺ J) 2 (q_0 − q_ref)
//! ```
//!
//! The result is integrated with the control period and not corrected by the measured position: the robot's own
//! position servos close the loop. The arm is therefore stiff. A force axis, and a compliant axis with an admittance, moves
//! with the sensed force: see [`AdmittanceLimits`](crate::AdmittanceLimits). A compliant axis without one holds its
//! reference. With a [`ServoLead`], the lag of the servos is compensated: the setpoint is q_ref + q̇_ref/kp + g/(kp kv).
//!
//! J⁺ is the dynamically consistent inverse for an identity mass matrix, damped near singularities like that of the
//! torque controller.
//!
//! Joint tracking alone needs no inverse: q_ref is the reference itself.
//!
//! With a goal out of reach, the error and with it q̇_ref would grow without bound, and a target may jump. Therefore q̇_ref is
//! clipped to the limits of position, speed and acceleration, such that it keeps its direction. After a
//! limit was active, q_ref returns to the reference. Margins and fractions of the limits are those of [`LimitParameters`].

use crate::algebra::{add_transposed, product};
use crate::context::ControlContext;
use crate::controller::{ControlInput, Controller, StaleTarget};
use crate::error::{ControlError, Reason};
use crate::hierarchy::contact_condition::ContactCondition;
use crate::hierarchy::task_hierarchy::TaskHierarchy;
use crate::hierarchy::task_parameters::TaskSetParameters;
use crate::hierarchy::task_schedule::{RecordedSignals, TaskSchedule};
use crate::hierarchy::task_set::TaskSet;
use crate::limits::clip::VelocityClip;
use crate::limits::joint_limits::LimitParameters;
use crate::targets::Targets;
use crate::tasks::task::Task;
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::signal_names::LIMITED;
use opspace_backend::{Observable, SignalRecorder};
use opspace_model::{Data, JointUnits, Model, gravity, kinematics};
use std::fmt;

/// Gain of the reference error, 1/s.
pub const ERROR_GAIN_PER_S: f64 = 20.0;

/// Gain of the posture in the null space of the tasks, 1/s.
pub const POSTURE_GAIN_PER_S: f64 = 2.0;

/// Parameters of the joints' position servos for the compensation of their lag: one value per joint.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoLead {
    /// Gain kp of the position loop, 1/s (n): the servo lags by q̇/kp.
    pub kp_per_s: Vec<f64>,
    /// Stiffness kp kv of the servo, Nm/rad (n): the servo sags by g/(kp kv) under gravity.
    pub stiffness_nm_per_rad: Vec<f64>,
}

/// Controller that converts task references to joint positions by inverse kinematics.
pub struct InverseKinematicsController {
    schedule: TaskSchedule,
    context: ControlContext,
    /// Limits within which q_ref stays.
    clip: VelocityClip,
    lead: Option<ServoLead>,
    /// Kinematics and gravity at q_ref; the factor of M is replaced by the identity.
    data: Data,
    q: DVector<f64>,
    dq: DVector<f64>,
    /// Velocity of q_ref in the last cycle, rad/s or m/s (n).
    before: DVector<f64>,
    /// Part of q̇_ref that is not feedback, rad/s or m/s (n).
    feedforward: DVector<f64>,
    scratch: DVector<f64>,
    /// Last commanded joint positions, rad or m (n).
    streamed: DVector<f64>,
    joint_names: Vec<String>,
    units: JointUnits,
}

impl InverseKinematicsController {
    /// Creates a controller for the tasks of a task file; compensates the servo lag if `lead` is given.
    ///
    /// # Errors
    /// The errors of the torque controller; tasks without a reference motion; a force axis without an admittance; a lead
    /// whose length differs from the number of joints.
    pub fn new(
        model: &Model,
        parameters: &TaskSetParameters<'_>,
        context: &ControlContext,
        lead: Option<ServoLead>,
    ) -> Result<Self, ControlError> {
        let tasks = TaskSet::from_parameters(model, parameters, context, None)?;
        Self::build(model, tasks, &parameters.limits, context, lead)
    }

    /// Creates a controller for tasks that are built in code, with default [`LimitParameters`].
    ///
    /// # Errors
    /// Tasks without a reference motion; a force axis without an admittance; a lead whose length differs from the number of
    /// joints.
    pub fn from_tasks(
        model: &Model,
        tasks: TaskSet,
        context: &ControlContext,
        lead: Option<ServoLead>,
    ) -> Result<Self, ControlError> {
        Self::build(model, tasks, &LimitParameters::default(), context, lead)
    }

    fn build(
        model: &Model,
        tasks: TaskSet,
        limits: &LimitParameters,
        context: &ControlContext,
        lead: Option<ServoLead>,
    ) -> Result<Self, ControlError> {
        let n = model.n();
        check_motion(&tasks.0)?;
        if let Some(lead) = &lead {
            for (key, list) in
                [("kp_per_s", &lead.kp_per_s), ("stiffness_nm_per_rad", &lead.stiffness_nm_per_rad)]
            {
                if list.len() != n {
                    return Err(ControlError::new(key, Reason::JointCount { given: list.len(), joints: n }));
                }
            }
        }
        let mut data = Data::new(model);
        data.mass_matrix_factor.set_identity();
        Ok(Self {
            schedule: TaskSchedule::new(tasks, RecordedSignals::Motion),
            context: context.clone(),
            clip: if limits.enforce {
                let (period_s, narrowed) = (context.period_s, context.limits.clone().narrowed(limits));
                VelocityClip::new(model, narrowed, limits.horizon_s(period_s), period_s)
            } else {
                VelocityClip::none(n)
            },
            lead,
            data,
            q: DVector::zeros(n),
            dq: DVector::zeros(n),
            before: DVector::zeros(n),
            feedforward: DVector::zeros(n),
            scratch: DVector::zeros(n),
            streamed: DVector::zeros(n),
            joint_names: model.joints().iter().map(|joint| joint.name.clone()).collect(),
            units: model.joint_units(),
        })
    }

    /// Builds another task set for the same robot, to be [scheduled](Self::schedule).
    ///
    /// # Errors
    /// The errors of [`new`](Self::new); a task whose kind differs from that of the existing task of the same name.
    pub fn prepare(
        &self,
        model: &Model,
        parameters: &TaskSetParameters<'_>,
    ) -> Result<TaskSet, ControlError> {
        let prepared = self.schedule.prepare(model, parameters, &self.context)?;
        check_motion(&prepared.0)?;
        Ok(prepared)
    }

    /// Schedules `tasks`: they become active at `time_s`, s after the start.
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
    /// The errors of [`prepare`](Self::prepare).
    pub fn add_task_set(&mut self, tasks: TaskSet) -> Result<u32, ControlError> {
        check_motion(&tasks.0)?;
        self.schedule.add(tasks)
    }

    /// Number of the active task set.
    #[must_use]
    pub fn task_set(&self) -> usize {
        self.schedule.number()
    }

    /// Computes q̇_ref at q_ref, and its part without feedback, for the latest targets of the tasks.
    fn solve(&mut self, model: &Model) {
        self.feedforward.fill(0.0);
        let hierarchy = self.schedule.current_mut();
        self.dq.fill(0.0);
        hierarchy.nullspace.reset();
        for level in &mut hierarchy.levels {
            level.project(model, &self.data, &hierarchy.nullspace, level.typical.kinematic);
            level.projected.compute_jbar(&self.data.mass_matrix_factor);
            for (gain, dq) in [(ERROR_GAIN_PER_S, &mut self.dq), (0.0, &mut self.feedforward)] {
                let mut velocity = level.task.kinematic_command(model, &self.data, gain);
                velocity -= product(level.jacobian(), dq.as_slice());
                add_transposed(&level.projected.space.jbar_transpose, &velocity, dq.as_mut_slice());
            }
            hierarchy.nullspace.push(&level.projected);
        }
        let (q, velocity) = (self.q.as_slice(), self.scratch.as_mut_slice());
        let Some(joint) = &hierarchy.joint else { return };
        let gains = [(ERROR_GAIN_PER_S, POSTURE_GAIN_PER_S), (0.0, 0.0)];
        for ((gain, posture_gain), dq) in gains.into_iter().zip([&mut self.dq, &mut self.feedforward]) {
            if joint.kinematic_target(q, gain, posture_gain, velocity) {
                hierarchy.nullspace.project_velocity(velocity);
                dq.iter_mut().zip(&*velocity).for_each(|(dq, velocity)| *dq += velocity);
            }
        }
    }

    /// Follows the tasks by inverse kinematics: moves q_ref at q̇_ref of the last cycle, and computes the next q̇_ref.
    fn follow_tasks(&mut self, model: &Model) {
        self.q.axpy(self.context.period_s, &self.dq, 1.0);
        kinematics(model, &mut self.data, self.q.as_slice(), self.dq.as_slice());
        self.before.copy_from(&self.dq);
        self.solve(model);
        self.clip.clip(
            self.dq.as_mut_slice(),
            self.feedforward.as_slice(),
            self.q.as_slice(),
            self.before.as_slice(),
            ERROR_GAIN_PER_S,
        );
    }

    /// Follows the reference of the joints: q_ref is the reference where the limits allow it, and returns to it elsewhere.
    fn follow_joints(&mut self, model: &Model) {
        let period_s = self.context.period_s;
        let joint = self.schedule.current().0.joint.as_ref();
        let Some((reference, velocity)) = joint.and_then(|task| task.reference()) else { return };
        for i in 0..self.q.len() {
            let target = self.clip.within_range(i, reference[i]);
            self.scratch[i] = target;
            let ahead = if target == reference[i] { velocity[i] } else { 0.0 };
            let exact = (target - self.q[i]) / period_s;
            if self.clip.allows(i, self.q[i], exact, self.before[i]) || exact.is_nan() {
                (self.dq[i], self.feedforward[i]) = (exact, exact);
            } else {
                let error = target - self.q[i] - period_s * ahead;
                (self.dq[i], self.feedforward[i]) = (ahead + ERROR_GAIN_PER_S * error, ahead);
            }
        }
        // Velocities that the clip leaves are exact.
        self.streamed.copy_from(&self.dq);
        self.clip.clip(
            self.dq.as_mut_slice(),
            self.feedforward.as_slice(),
            self.q.as_slice(),
            self.before.as_slice(),
            ERROR_GAIN_PER_S,
        );
        for (i, &velocity) in velocity.iter().enumerate() {
            let dq = self.dq[i];
            let is_exact = dq == self.streamed[i] && dq == self.feedforward[i];
            self.before[i] = dq;
            if is_exact {
                (self.q[i], self.dq[i]) = (self.scratch[i], velocity);
            } else {
                self.q[i] += period_s * dq;
            }
        }
        kinematics(model, &mut self.data, self.q.as_slice(), self.dq.as_slice());
    }

    /// Writes q_ref, with compensation of the servo lag, into `command` (n; rad or m).
    fn stream(&mut self, command: &mut [f64]) {
        for (i, out) in command.iter_mut().enumerate() {
            *out = self.q[i];
            if let Some(lead) = &self.lead {
                *out += self.dq[i] / lead.kp_per_s[i];
            }
            *out += self.sag(i);
        }
        self.streamed.copy_from_slice(command);
    }

    /// Setpoint offset that compensates the servo's sag under gravity at the posture of `data`, rad or m.
    fn sag(&self, joint: usize) -> f64 {
        match &self.lead {
            Some(lead) if !self.context.gravity_by_robot => {
                self.data.gravity[joint] / lead.stiffness_nm_per_rad[joint]
            }
            _ => 0.0,
        }
    }
}

impl fmt::Debug for InverseKinematicsController {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut debug = f.debug_struct("InverseKinematicsController");
        debug.field("tasks", self.schedule.current()).field("lead", &self.lead).finish_non_exhaustive()
    }
}

impl Controller for InverseKinematicsController {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Position
    }

    fn targets(&self) -> Targets {
        self.schedule.targets().clone()
    }

    fn stale_target(&self) -> Option<StaleTarget> {
        self.schedule.current().0.stale_target()
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.q.copy_from(&input.measurement.q);
        self.dq.fill(0.0);
        self.before.fill(0.0);
        self.schedule.start(input);
    }

    fn observe_while_held(&mut self, input: &ControlInput<'_>) {
        self.schedule.advance(input);
        self.schedule.current_mut().observe(input);
    }

    /// Continues from the setpoints of the hold instead of the measured position, so that they do not jump.
    fn resume(&mut self, input: &ControlInput<'_>) {
        self.schedule.advance(input);
        self.dq.fill(0.0);
        self.before.fill(0.0);
        for i in 0..self.q.len() {
            self.q[i] = self.streamed[i] - self.sag(i);
        }
        kinematics(input.model, &mut self.data, self.q.as_slice(), self.dq.as_slice());
        self.schedule.current_mut().resume(&ControlInput { data: &self.data, ..*input });
    }

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        let model = input.model;
        self.schedule.advance(input);
        let hierarchy = self.schedule.current_mut();
        hierarchy.observe_with_forces(input);
        let in_joints = hierarchy.levels.is_empty();
        self.clip.begin();
        // Without tasks above the joint task nothing is solved, and integration drift is avoided.
        if in_joints {
            self.follow_joints(model);
        } else {
            self.follow_tasks(model);
        }
        if self.lead.is_some() {
            gravity(model, &mut self.data);
        }
        self.stream(command);
    }
}

impl Observable for InverseKinematicsController {
    fn record(&self, out: &mut SignalRecorder<'_>) {
        self.schedule.record(out);
        out.signal("ik.q", &self.units.position, &self.joint_names, self.q.as_slice());
        out.signal("ik.dq", &self.units.velocity, &self.joint_names, self.dq.as_slice());
        out.signal(LIMITED, "1", &self.joint_names, self.clip.limited());
    }
}

/// Checks that there is a task to follow, and that each task can be followed.
fn check_motion(hierarchy: &TaskHierarchy) -> Result<(), ControlError> {
    let follows = hierarchy.joint.as_ref().is_some_and(|task| task.reference().is_some());
    if hierarchy.levels.is_empty() && !follows {
        return Err(ControlError::new("priority", Reason::NoMotion));
    }
    hierarchy.tasks().find_map(Task::kinematic_infeasibility).map_or(Ok(()), Err)
}
