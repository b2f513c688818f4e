//! Tracking: the joints follow a reference, in the null space of the other tasks.
//!
//! ```text
//! τ = Nᵀ M (q̈_d + 2ζω (q̇_d − q̇) + ω² (q_d − q))
//! ```

use crate::algebra::multiply;
use crate::controller::ControlInput;
use crate::error::ControlError;
use crate::references::joint_reference::{JointMotion, JointReference, JointTrajectory};
use crate::references::streamed_joints::StreamedJoints;
use crate::targets::TaskTarget;
use crate::tasks::joint_parameters::{JointFeedback, JointGains, JointTrackingParameters};
use crate::tasks::joint_target::{Input, JOINT_INPUTS};
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::{RowGains, TaskInput, TaskSignals};
use crate::tasks::when_limited::{WhenLimited, joint_weights};
use nalgebra::DVector;
use opspace_backend::signal_names::{self, ERROR, REFERENCE, REFERENCE_VELOCITY, SLACK};
use opspace_backend::{Signal, SignalRecorder};
use opspace_model::{Data, JointUnits, Model};
use std::any::Any;

/// Joint tracking task: see [`JointTrackingParameters`].
#[derive(Clone, Debug)]
pub struct Tracking {
    name: String,
    joint_names: Vec<String>,
    units: JointUnits,
    parameters: JointReference,
    trajectory: JointTrajectory,
    /// Streamed reference, used instead of the trajectory.
    streamed: Option<StreamedJoints>,
    /// Joints of the streamed inputs.
    joints: Vec<usize>,
    /// Start time of the trajectory, s.
    start_s: f64,
    /// Posture at the start of the run (n).
    home: DVector<f64>,
    gains: JointFeedback,
    /// Weights of `joints`.
    weights: Option<Vec<f64>>,
    when_limited: WhenLimited,
    reference: DVector<f64>,
    reference_velocity: DVector<f64>,
    reference_acceleration: DVector<f64>,
    error: DVector<f64>,
    /// Reference without blending (n).
    path: DVector<f64>,
    path_velocity: DVector<f64>,
}

impl Tracking {
    /// Creates a task of all joints from its parameters.
    ///
    /// # Errors
    /// Unknown names, missing values.
    pub fn new(
        name: &str,
        parameters: &JointTrackingParameters,
        model: &Model,
    ) -> Result<Self, ControlError> {
        Self::of_joints(name, parameters, model, (0..model.n()).collect())
    }

    /// Creates a task like [`new`](Self::new), but with streamed inputs for `joints` only.
    pub(crate) fn of_joints(
        name: &str,
        parameters: &JointTrackingParameters,
        model: &Model,
        joints: Vec<usize>,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.joint-tracking");
        let JointGains { frequency_rad_per_s, damping_ratio } = &parameters.gains;
        let zero = DVector::zeros(model.n());
        let streamed = match &parameters.reference {
            JointReference::Streamed(reference) => {
                let key = format!("{key}.reference.streamed");
                Some(StreamedJoints::new(reference, joints.clone(), model, &key)?)
            }
            _ => None,
        };
        Ok(Self {
            name: name.to_owned(),
            joint_names: model.joints().iter().map(|j| j.name.clone()).collect(),
            units: model.joint_units(),
            parameters: parameters.reference.clone(),
            trajectory: JointTrajectory::new(&parameters.reference, model, &format!("{key}.reference"))?,
            weights: joint_weights(&parameters.weight, &joints, model, &format!("{key}.weight"))?,
            when_limited: parameters.when_limited,
            streamed,
            joints,
            start_s: 0.0,
            home: zero.clone(),
            gains: JointFeedback::new(frequency_rad_per_s, damping_ratio, model, &format!("{key}.gains"))?,
            reference: zero.clone(),
            reference_velocity: zero.clone(),
            reference_acceleration: zero.clone(),
            error: zero.clone(),
            path: zero.clone(),
            path_velocity: zero,
        })
    }

    fn begin_at(&mut self, input: &ControlInput<'_>) {
        let q = &input.measurement.q;
        self.home.copy_from(q);
        self.rest_at(q.as_slice());
        self.begin(q.as_slice(), input);
    }

    /// Sets the reference to rest at `q` (n).
    fn rest_at(&mut self, q: &[f64]) {
        self.reference.copy_from_slice(q);
        self.reference_velocity.fill(0.0);
        self.reference_acceleration.fill(0.0);
    }

    /// Blends from `q` (n), at rest, into the reference; replans a goal or streamed reference from there.
    fn rejoin(&mut self, q: &[f64], input: &ControlInput<'_>) {
        if self.trajectory.is_online() || self.streamed.is_some() {
            self.rest_at(q);
            self.begin(q, input);
        } else {
            self.trajectory.join(input.measurement.time_s - self.start_s, q);
            self.update_reference(q, input);
        }
    }

    /// Continues an unchanged reference; starts a different one at the previous reference.
    pub(crate) fn continue_from(&mut self, before: &mut Self, input: &ControlInput<'_>) {
        let q = input.measurement.q.as_slice();
        before.update_reference(q, input);
        self.home.copy_from(&before.home);
        if self.parameters == before.parameters && self.joints == before.joints {
            std::mem::swap(&mut self.trajectory, &mut before.trajectory);
            std::mem::swap(&mut self.streamed, &mut before.streamed);
            self.start_s = before.start_s;
            self.update_reference(q, input);
            return;
        }
        self.reference.copy_from(&before.reference);
        self.reference_velocity.copy_from(&before.reference_velocity);
        self.reference_acceleration.copy_from(&before.reference_acceleration);
        self.begin(q, input);
    }

    /// Starts the trajectory at the current reference.
    fn begin(&mut self, q: &[f64], input: &ControlInput<'_>) {
        self.start_s = input.measurement.time_s;
        let (x, v, a) = (&self.reference, &self.reference_velocity, &self.reference_acceleration);
        let from = JointMotion { position: x.as_slice(), velocity: v.as_slice(), acceleration: a.as_slice() };
        self.trajectory.start(self.home.as_slice(), &from);
        if let Some(streamed) = &mut self.streamed {
            streamed.begin(input.clock_s, |joint| [x[joint], v[joint], a[joint]]);
        }
        self.update_reference(q, input);
    }

    /// Processes the streamed target of a cycle.
    fn take_target(&mut self, target: &TaskTarget<'_>) {
        if let Some(streamed) = &mut self.streamed {
            streamed.update(target);
        }
    }

    /// Updates reference and error of the joints at positions `q` (n).
    fn update_reference(&mut self, q: &[f64], input: &ControlInput<'_>) {
        let time_s = input.measurement.time_s - self.start_s;
        for (i, q) in q.iter().enumerate() {
            let ([position, velocity, acceleration], away) = match &self.streamed {
                Some(streamed) => (streamed.at(i, input.clock_s), [0.0; 3]),
                None => (self.trajectory.reference_at(i, time_s), self.trajectory.away(i, time_s)),
            };
            self.path[i] = position;
            self.path_velocity[i] = velocity;
            self.reference[i] = position + away[0];
            self.reference_velocity[i] = velocity + away[1];
            self.reference_acceleration[i] = acceleration + away[2];
            self.error[i] = self.reference[i] - q;
        }
    }

    /// Inputs of a streamed reference.
    pub(crate) fn streamed_inputs(&self) -> Vec<Signal> {
        if self.streamed.is_none() {
            return Vec::new();
        }
        let names: Vec<&str> = self.joints.iter().map(|&joint| self.joint_name(joint)).collect();
        let input = |(name, units): Input| {
            let units: Vec<&str> = self.joints.iter().map(|&joint| units(&self.units)[joint]).collect();
            Signal::new(name, &units, &names)
        };
        JOINT_INPUTS.map(input).into()
    }

    pub(crate) fn stop_for_stale_age_s(&self) -> Option<f64> {
        self.streamed.as_ref().and_then(|streamed| streamed.freshness().stop_for_age_s())
    }

    fn acceleration(&self, data: &Data, out: &mut [f64]) {
        for (i, a) in out.iter_mut().enumerate() {
            *a = self.desired_acceleration(data, i);
        }
    }

    /// Desired acceleration q̈* of a joint, rad/s² or m/s².
    pub(crate) fn desired_acceleration(&self, data: &Data, i: usize) -> f64 {
        self.reference_acceleration[i]
            + self.gains.damping[i] * (self.reference_velocity[i] - data.dq[i])
            + self.gains.stiffness[i] * self.error[i]
    }

    /// Acceleration of a joint's reference, rad/s² or m/s².
    pub(crate) fn reference_acceleration_of(&self, joint: usize) -> f64 {
        self.reference_acceleration[joint]
    }

    /// Reference velocity plus gain times error, of a joint at `q` (rad/s or m/s).
    pub(crate) fn kinematic_target_of(&self, joint: usize, q: f64, gain_per_s: f64) -> f64 {
        self.reference_velocity[joint] + gain_per_s * (self.reference[joint] - q)
    }

    /// Name of a joint.
    pub(crate) fn joint_name(&self, joint: usize) -> &str {
        &self.joint_names[joint]
    }

    /// Unit of a joint's position: rad or m.
    pub(crate) fn position_unit(&self, joint: usize) -> &'static str {
        self.units.position[joint]
    }

    /// Signal of the acceleration that limits take from the joints (n).
    pub(crate) fn slack_signal(&self) -> Signal {
        let units: Vec<String> = self.units.position.iter().map(|unit| format!("{unit}/s²")).collect();
        Signal::new(signal_names::of(&self.name, SLACK), &units, &self.joint_names)
    }

    /// Linearised gains of a joint: stiffness (1/s²) and damping (1/s).
    pub(crate) fn gains_of(&self, joint: usize) -> [f64; 2] {
        [self.gains.stiffness[joint], self.gains.damping[joint]]
    }
}

impl JointTask for Tracking {
    fn name(&self) -> &str {
        &self.name
    }

    fn update(&mut self, input: &TaskInput<'_>, acceleration: &mut [f64], torque: &mut [f64]) {
        let data = input.control.data;
        self.take_target(&input.target);
        self.update_reference(data.q.as_slice(), &input.control);
        self.acceleration(data, acceleration);
        multiply(&data.mass_matrix, acceleration, torque);
    }

    fn kinematic_target(&self, q: &[f64], gain_per_s: f64, _posture_gain: f64, velocity: &mut [f64]) -> bool {
        for (joint, (velocity, &q)) in velocity.iter_mut().zip(q).enumerate() {
            *velocity = self.kinematic_target_of(joint, q, gain_per_s);
        }
        true
    }

    fn weights(&self) -> Option<&[f64]> {
        self.weights.as_deref()
    }

    fn when_limited(&self) -> WhenLimited {
        self.when_limited
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.begin_at(input);
    }

    fn observe(&mut self, input: &TaskInput<'_>) {
        self.take_target(&input.target);
        self.update_reference(input.control.measurement.q.as_slice(), &input.control);
    }

    fn resume(&mut self, input: &ControlInput<'_>) {
        self.rejoin(input.data.q.as_slice(), input);
    }

    fn inherit(&mut self, before: &mut dyn JointTask, input: &ControlInput<'_>) {
        match (before as &mut dyn Any).downcast_mut::<Self>() {
            Some(before) => self.continue_from(before, input),
            None => self.begin_at(input),
        }
    }

    fn inputs(&self) -> Vec<Signal> {
        self.streamed_inputs()
    }

    fn stop_for_age_s(&self) -> Option<f64> {
        self.stop_for_stale_age_s()
    }

    fn reference(&self) -> Option<(&[f64], &[f64])> {
        Some((self.reference.as_slice(), self.reference_velocity.as_slice()))
    }

    fn gains(&self, joint: usize, _inertia: f64) -> Option<RowGains> {
        let [stiffness_per_s2, damping_per_s] = self.gains_of(joint);
        Some(RowGains { stiffness_per_s2, damping_per_s, integral_per_s: 0.0 })
    }

    fn kind(&self) -> &'static str {
        "joint-tracking of all joints"
    }

    fn record(&self, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
        let Self { name, units, joint_names: joints, path, path_velocity, error, .. } = self;
        match (signals, &self.streamed) {
            (TaskSignals::Motion, _) => {
                out.signal((name, REFERENCE), &units.position, joints, path.as_slice());
                out.signal((name, REFERENCE_VELOCITY), &units.velocity, joints, path_velocity.as_slice());
                out.signal((name, ERROR), &units.position, joints, error.as_slice());
            }
            (TaskSignals::Target, Some(streamed)) => streamed.freshness().record(name, out),
            _ => {}
        }
    }
}
