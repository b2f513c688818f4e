//! The baseline without torques: inverse kinematics, streamed as joint positions.
//!
//! ```text
//! q̇_ref = J⁺ (ẋ_d + 20 (x_d − x(q_ref))) + (I − J⁺ J) 2 (q_0 − q_ref)
//! ```
//!
//! integrated at the robot's period, never corrected by the measured position: the robot's own servo closes the loop.
//! Stiff by nature: a compliant axis holds its reference. With a [`ServoLead`], the lag of the servo is compensated:
//! q_ref + q̇_ref/kp + g/(kp kv).
//!
//! J⁺ is the dynamically consistent inverse of an arm whose mass matrix is the identity, damped near
//! singularities as the torque controller's is.

use crate::context::ControlContext;
use crate::controller::{ControlInput, Controller, StaleTarget};
use crate::error::{ControlError, Reason};
use crate::hierarchy::products::{add_transposed, product};
use crate::hierarchy::task_hierarchy::TaskHierarchy;
use crate::hierarchy::task_parameters::TaskSetParameters;
use crate::hierarchy::task_schedule::{RecordedSignals, TaskSchedule};
use crate::hierarchy::task_set::TaskSet;
use crate::targets::Targets;
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::{Observable, SignalRecorder};
use opspace_model::{Data, JointUnits, Model, gravity, kinematics};
use std::fmt;

/// Gain with which the error of a reference decays, 1/s.
pub const ERROR_GAIN_PER_S: f64 = 20.0;

/// Gain with which the posture is restored where the tasks leave freedom, 1/s.
pub const POSTURE_GAIN_PER_S: f64 = 2.0;

/// Parameters of the joints' position servos by which their lag is compensated: one value per joint.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoLead {
    /// Gain kp of the position loop, 1/s: the servo lags q̇/kp behind.
    pub kp_per_s: Vec<f64>,
    /// Stiffness kp kv of the servo, Nm/rad: it sags by g over it.
    pub stiffness_nm_per_rad: Vec<f64>,
}

/// Controller that converts task references to joint positions by inverse kinematics.
pub struct InverseKinematicsController {
    schedule: TaskSchedule,
    context: ControlContext,
    lead: Option<ServoLead>,
    /// Kinematics and gravity at the reference posture, with the identity in place of M's factor.
    data: Data,
    q: DVector<f64>,
    dq: DVector<f64>,
    scratch: DVector<f64>,
    /// Joint positions streamed last, rad or m (n).
    streamed: DVector<f64>,
    joint_names: Vec<String>,
    units: JointUnits,
}

impl InverseKinematicsController {
    /// A controller of the tasks in a file, with compensation of the servos' lag if a lead is given.
    ///
    /// # Errors
    /// As for the torque controller; tasks without a motion to follow; a lead of another length than the number of
    /// joints.
    pub fn new(
        model: &Model,
        parameters: &TaskSetParameters<'_>,
        context: &ControlContext,
        lead: Option<ServoLead>,
    ) -> Result<Self, ControlError> {
        Self::from_tasks(model, TaskSet::from_parameters(model, parameters, context)?, context, lead)
    }

    /// A controller of tasks that were built in code.
    ///
    /// # Errors
    /// Tasks without a motion to follow; a lead of another length than the number of joints.
    pub fn from_tasks(
        model: &Model,
        tasks: TaskSet,
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
            lead,
            data,
            q: DVector::zeros(n),
            dq: DVector::zeros(n),
            scratch: DVector::zeros(n),
            streamed: DVector::zeros(n),
            joint_names: model.joints().iter().map(|joint| joint.name.clone()).collect(),
            units: model.joint_units(),
        })
    }

    /// Another task set for the same robot, to be [scheduled](Self::schedule).
    ///
    /// # Errors
    /// As [`new`](Self::new), and a task that would change its kind.
    pub fn prepare(
        &self,
        model: &Model,
        parameters: &TaskSetParameters<'_>,
    ) -> Result<TaskSet, ControlError> {
        let prepared = self.schedule.prepare(model, parameters, &self.context)?;
        check_motion(&prepared.0)?;
        Ok(prepared)
    }

    /// MimicConstraint `tasks` from `time_s` on, s after the start.
    pub fn schedule(&mut self, time_s: f64, tasks: TaskSet) {
        self.schedule.schedule(time_s, tasks);
    }

    /// Adds a task set that can be chosen by its number ([`Targets::choose_task_set`]), which is returned: the first
    /// one has 0, and scheduled ones have numbers as well. Before the start, so that its tasks are in the log and in
    /// the targets.
    ///
    /// # Errors
    /// As [`prepare`](Self::prepare).
    pub fn add_task_set(&mut self, tasks: TaskSet) -> Result<u32, ControlError> {
        check_motion(&tasks.0)?;
        self.schedule.add(tasks)
    }

    /// Number of the task set in force.
    #[must_use]
    pub fn task_set(&self) -> usize {
        self.schedule.number()
    }

    /// q̇_ref at q_ref and the targets that the tasks saw last.
    fn solve(&mut self, model: &Model) {
        let hierarchy = self.schedule.current_mut();
        self.dq.fill(0.0);
        hierarchy.nullspace.reset();
        for level in &mut hierarchy.levels {
            level.project(model, &self.data, &hierarchy.nullspace, level.typical.kinematic);
            level.projected.compute_jbar(&self.data.mass_matrix_factor);
            let mut velocity = level.task.kinematic_target(model, &self.data, ERROR_GAIN_PER_S);
            velocity -= product(level.jacobian(), self.dq.as_slice());
            add_transposed(&level.projected.space.jbar_transpose, &velocity, self.dq.as_mut_slice());
            hierarchy.nullspace.push(&level.projected);
        }
        let (q, velocity) = (self.q.as_slice(), self.scratch.as_mut_slice());
        let joint = hierarchy.joint.as_ref();
        if joint.is_some_and(|task| task.kinematic_target(q, ERROR_GAIN_PER_S, POSTURE_GAIN_PER_S, velocity))
        {
            hierarchy.nullspace.project_velocity(velocity);
            self.dq += &self.scratch;
        }
    }

    /// Computes q_ref with the compensation of the servo's lag.
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

    /// Offset of a setpoint that compensates the servo's sag under gravity at `data`'s posture, rad or m.
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
        self.schedule.start(input);
    }

    fn observe_while_held(&mut self, input: &ControlInput<'_>) {
        self.schedule.advance(input);
        self.schedule.current_mut().observe(input);
    }

    /// Continues from the setpoints that held the robot, not from where they left it, so that they don't jump.
    fn resume(&mut self, input: &ControlInput<'_>) {
        self.schedule.advance(input);
        self.dq.fill(0.0);
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
        hierarchy.observe(input);
        let in_joints = hierarchy.levels.is_empty();
        let reference = hierarchy.joint.as_ref().and_then(|task| task.reference());
        // With nothing above it there is nothing to solve, and no integration to drift.
        if in_joints && let Some((position, velocity)) = reference {
            self.q.as_mut_slice().copy_from_slice(position);
            self.dq.as_mut_slice().copy_from_slice(velocity);
        }
        kinematics(model, &mut self.data, self.q.as_slice(), self.dq.as_slice());
        if !in_joints {
            self.solve(model);
        }
        if self.lead.is_some() {
            gravity(model, &mut self.data);
        }
        self.stream(command);
        if !in_joints {
            self.q.axpy(self.context.period_s, &self.dq, 1.0);
        }
    }
}

impl Observable for InverseKinematicsController {
    fn record(&self, out: &mut SignalRecorder<'_>) {
        self.schedule.record(out);
        out.signal("ik.q", &self.units.position, &self.joint_names, self.q.as_slice());
        out.signal("ik.dq", &self.units.velocity, &self.joint_names, self.dq.as_slice());
    }
}

/// There must be something to follow.
fn check_motion(hierarchy: &TaskHierarchy) -> Result<(), ControlError> {
    let follows = hierarchy.joint.as_ref().is_some_and(|task| task.reference().is_some());
    if hierarchy.levels.is_empty() && !follows {
        return Err(ControlError::new("priority", Reason::NoMotion));
    }
    Ok(())
}
