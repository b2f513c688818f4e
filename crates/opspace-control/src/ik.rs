//! The baseline without torques: inverse kinematics, streamed as joint positions.
//!
//! ```text
//! q̇_ref = J⁺ (ẋ_d + 20 (x_d − x(q_ref))) + (I − J⁺ J) 2 (q_0 − q_ref)
//! ```
//!
//! integrated at the robot's period, never corrected by the measured position: the robot's own servo
//! closes the loop. Stiff by nature: a compliant axis holds its reference. With a [`ServoLead`], what
//! the servo lags behind is added: q_ref + q̇_ref/kp + g/(kp kv).
//!
//! J⁺ is the dynamically consistent inverse of an arm whose mass matrix is the identity, damped near
//! singularities as the torque controller's is.

use crate::context::ControlContext;
use crate::controller::{ControlInput, Controller};
use crate::error::{ControlError, Reason};
use crate::hierarchy::level::RowTask;
use crate::hierarchy::products::{add_transposed, product};
use crate::hierarchy::stacks::{PreparedStack, Shows, Stacks};
use crate::hierarchy::task::{Levels, Stack};
use crate::tasks::joint::JointTask;
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::{Observable, Row, Signal};
use opspace_model::{Data, Model, gravity, kinematics};

/// How fast the error of a reference is worked off, 1/s.
pub const ERROR_GAIN_PER_S: f64 = 20.0;

/// How fast the posture is returned to where the tasks leave freedom, 1/s.
pub const POSTURE_GAIN_PER_S: f64 = 2.0;

/// What of the joints' position servos can be led: one number a joint each.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoLead {
    /// Gain kp of the position loop, 1/s: the servo lags q̇/kp behind.
    pub kp_per_s: Vec<f64>,
    /// Stiffness kp kv of the servo, Nm/rad: it sags by g over it.
    pub stiffness_nm_per_rad: Vec<f64>,
}

/// References to joint positions.
#[derive(Clone, Debug)]
pub struct InverseKinematicsController {
    stacks: Stacks,
    robot: ControlContext,
    lead: Option<ServoLead>,
    /// Of the reference posture, with the identity in place of M's factor.
    data: Data,
    q: DVector<f64>,
    dq: DVector<f64>,
    scratch: DVector<f64>,
    /// What was streamed last (n).
    streamed: DVector<f64>,
    own_signals: Vec<Signal>,
}

impl InverseKinematicsController {
    /// The tasks of `stack` for a robot, with a lead against its servos' lag if one is given.
    ///
    /// # Errors
    /// As for the torque controller; a stack without a motion to follow; a lead of another length than
    /// the number of joints.
    pub fn new(
        model: &Model,
        stack: &Stack<'_>,
        robot: &ControlContext,
        lead: Option<ServoLead>,
    ) -> Result<Self, ControlError> {
        let stacks = Stacks::new(model, stack, robot, Shows::Motion)?;
        let n = model.n();
        check_motion(stacks.in_force())?;
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
        let joints: Vec<&str> = model.joints().iter().map(|j| j.name.as_str()).collect();
        let own_signals = vec![Signal::new("ik.q", "rad", &joints), Signal::new("ik.dq", "rad/s", &joints)];
        Ok(Self {
            stacks,
            robot: robot.clone(),
            lead,
            data,
            q: DVector::zeros(n),
            dq: DVector::zeros(n),
            scratch: DVector::zeros(n),
            streamed: DVector::zeros(n),
            own_signals,
        })
    }

    /// Another stack for the same robot, to be [scheduled](Self::schedule).
    ///
    /// # Errors
    /// As [`new`](Self::new), and a task that would change its kind.
    pub fn prepare(&self, model: &Model, stack: &Stack<'_>) -> Result<PreparedStack, ControlError> {
        let prepared = self.stacks.prepare(model, stack, &self.robot)?;
        check_motion(prepared.levels())?;
        Ok(prepared)
    }

    /// Follows `stack` from `time_s` on, s after the start.
    pub fn schedule(&mut self, time_s: f64, stack: PreparedStack) {
        self.stacks.schedule(time_s, stack);
    }

    /// q̇_ref at q_ref and the targets that the tasks saw last.
    fn solve(&mut self, model: &Model) {
        let levels = self.stacks.current();
        self.dq.fill(0.0);
        levels.nullspace.reset();
        for level in &mut levels.rows {
            level.project(model, &self.data, &levels.nullspace, level.typical.kinematic);
            level.projected.finish(&self.data.mass_matrix_factor);
            let mut wanted = match &level.task {
                RowTask::Cartesian(task) => task.velocity_at(model, &self.data, ERROR_GAIN_PER_S),
                RowTask::Joints(task) => task.velocity(&self.q, ERROR_GAIN_PER_S),
            };
            wanted -= product(level.jacobian(), self.dq.as_slice());
            add_transposed(&level.projected.space.jbar_transpose, &wanted, self.dq.as_mut_slice());
            levels.nullspace.narrow(&level.projected);
        }
        match &levels.joint {
            Some(JointTask::Posture(task)) => {
                for ((v, q0), q) in self.scratch.iter_mut().zip(&task.posture).zip(&self.q) {
                    *v = POSTURE_GAIN_PER_S * (q0 - q);
                }
            }
            Some(JointTask::Tracking(task)) => {
                for (i, v) in self.scratch.iter_mut().enumerate() {
                    *v = task.reference_velocity[i] + ERROR_GAIN_PER_S * (task.reference[i] - self.q[i]);
                }
            }
            Some(JointTask::Damping(_)) | None => return,
        }
        levels.nullspace.project_velocity(self.scratch.as_mut_slice());
        self.dq += &self.scratch;
    }

    /// q_ref with what the servo needs to be led by.
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

    /// What a set-point makes up for of the servo's sag at `data`'s posture.
    fn sag(&self, joint: usize) -> f64 {
        match &self.lead {
            Some(lead) if !self.robot.gravity_by_robot => {
                self.data.gravity[joint] / lead.stiffness_nm_per_rad[joint]
            }
            _ => 0.0,
        }
    }
}

impl Controller for InverseKinematicsController {
    fn command_kind(&self) -> CommandKind {
        CommandKind::Position
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.q.copy_from(&input.measurement.q);
        self.dq.fill(0.0);
        self.stacks.start(input);
    }

    fn observe_while_held(&mut self, input: &ControlInput<'_>) {
        self.stacks.advance(input);
        self.stacks.current().observe(input);
    }

    /// Goes on from the set-points that held the robot, not from where they left it: so they don't jump.
    fn resume(&mut self, input: &ControlInput<'_>) {
        self.stacks.advance(input);
        self.dq.fill(0.0);
        for i in 0..self.q.len() {
            self.q[i] = self.streamed[i] - self.sag(i);
        }
        kinematics(input.model, &mut self.data, self.q.as_slice(), self.dq.as_slice());
        self.stacks.current().resume(&ControlInput { data: &self.data, ..*input });
    }

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        let ControlInput { model, measurement, .. } = *input;
        self.stacks.advance(input);
        let levels = self.stacks.current();
        for level in &mut levels.rows {
            level.observe(input);
        }
        let in_joints = levels.rows.is_empty();
        if let Some(JointTask::Tracking(task)) = &mut levels.joint {
            task.observe(measurement.q.as_slice(), measurement.time_s);
            // With nothing above it there is nothing to solve, and no integration to drift.
            if in_joints {
                self.q.copy_from(&task.reference);
                self.dq.copy_from(&task.reference_velocity);
            }
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
            self.q.axpy(self.robot.period_s, &self.dq, 1.0);
        }
    }
}

impl Observable for InverseKinematicsController {
    fn signals(&self) -> Vec<Signal> {
        let mut signals = self.stacks.signals();
        signals.extend(self.own_signals.iter().cloned());
        signals
    }

    fn sample(&self, row: &mut Row<'_>) {
        self.stacks.sample(row);
        row.put(self.q.as_slice());
        row.put(self.dq.as_slice());
    }
}

/// There must be something to follow.
fn check_motion(levels: &Levels) -> Result<(), ControlError> {
    if levels.rows.is_empty() && !matches!(levels.joint, Some(JointTask::Tracking(_))) {
        return Err(ControlError::new("priority", Reason::NoMotion));
    }
    Ok(())
}
