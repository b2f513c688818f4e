//! A task of up to six selected joints that follow a reference; other tasks can be below it.
//!
//! ```text
//! x = S q        J = S        a* = q̈_d + 2ζω (q̇_d − q̇) + ω² (q_d − q)
//! ```
//!
//! S selects the joints.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::error::{ControlError, Reason};
use crate::tasks::build_task::{BuildTask, BuiltTask, TaskReference};
use crate::tasks::joint_parameters::JointTrackingParameters;
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::{RowGains, Task, TaskInput, TaskSignals};
use crate::tasks::tracking::Tracking;
use crate::tasks::when_limited::WhenLimited;
use nalgebra::{Matrix6xX, Vector6};
use opspace_backend::{Signal, SignalRecorder};
use opspace_model::{Data, Inversion, Model};
use std::any::Any;

/// Damping threshold: a direction is damped if the tasks above reduce its mobility below this fraction of the joints'
/// typical mobility.
pub const JOINTS_SINGULARITY_THRESHOLD: f64 = 1e-3;

/// A task of up to six selected joints that follow a reference; other tasks can be below it.
#[derive(Clone, Debug)]
pub struct SelectedJoints {
    tracking: Tracking,
    joints: Vec<usize>,
    acceleration: Vector6<f64>,
}

/// Returns the indices of the joints `names`, from one to six, in this order; `key` is that of the list.
///
/// # Errors
/// An empty list, more than six joints, a joint that is listed twice, an unknown joint.
pub fn selected_joints(names: &[String], model: &Model, key: &str) -> Result<Vec<usize>, ControlError> {
    if names.is_empty() {
        return Err(ControlError::new(key, Reason::JointList));
    }
    let mut joints = Vec::with_capacity(names.len());
    for joint in names {
        let index = model.joint(joint).map_err(|unknown| ControlError::new(key, unknown))?;
        if joints.contains(&index) {
            return Err(ControlError::new(key, Reason::JointList));
        }
        joints.push(index);
    }
    if joints.len() > 6 {
        return Err(ControlError::new(key, Reason::TooManyJoints { joints: joints.len(), most: 6 }));
    }
    Ok(joints)
}

impl SelectedJoints {
    /// Creates a task of the joints `names`, in this order.
    ///
    /// # Errors
    /// An empty list, more than six joints, a joint that is listed twice, an unknown joint.
    pub fn new(
        name: &str,
        names: &[String],
        parameters: &JointTrackingParameters,
        model: &Model,
    ) -> Result<Self, ControlError> {
        let joints = selected_joints(names, model, &format!("task.{name}.joint-tracking.joints"))?;
        let tracking = Tracking::of_joints(name, parameters, model, joints.clone())?;
        Ok(Self { tracking, joints, acceleration: Vector6::zeros() })
    }

    fn rows_of(&self, value: impl Fn(usize) -> f64) -> Vector6<f64> {
        let mut rows = Vector6::zeros();
        for (row, &joint) in rows.iter_mut().zip(&self.joints) {
            *row = value(joint);
        }
        rows
    }
}

impl BuildTask for JointTrackingParameters {
    fn build(&self, name: &str, model: &Model, _context: &ControlContext) -> Result<BuiltTask, ControlError> {
        match &self.joints {
            Some(joints) => Ok(BuiltTask::rows(SelectedJoints::new(name, joints, self, model)?)),
            None => Ok(BuiltTask::joints(Tracking::new(name, self, model)?)),
        }
    }

    fn reference(&self) -> Option<TaskReference<'_>> {
        Some(TaskReference::Joint(&self.reference))
    }
}

impl Task for SelectedJoints {
    fn name(&self) -> &str {
        self.tracking.name()
    }

    fn rows(&self) -> usize {
        self.joints.len()
    }

    fn jacobian(&self, _model: &Model, _data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        for (row, &joint) in self.joints.iter().enumerate() {
            rows[(row, joint)] = 1.0;
        }
    }

    fn update(&mut self, input: &TaskInput<'_>) {
        self.observe(input);
        self.acceleration =
            self.rows_of(|joint| self.tracking.desired_acceleration(input.control.data, joint));
    }

    fn bias(&self, _model: &Model, _data: &Data) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn kinematic_target(&self, _model: &Model, data: &Data, gain_per_s: f64) -> Vector6<f64> {
        self.rows_of(|joint| self.tracking.kinematic_target_of(joint, data.q[joint], gain_per_s))
    }

    fn acceleration(&self) -> Vector6<f64> {
        self.acceleration
    }

    fn reference_acceleration(&self) -> Vector6<f64> {
        self.rows_of(|joint| self.tracking.reference_acceleration_of(joint))
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.tracking.start(input);
    }

    fn observe(&mut self, input: &TaskInput<'_>) {
        self.tracking.observe(input);
    }

    fn resume(&mut self, input: &ControlInput<'_>) {
        self.tracking.resume(input);
    }

    fn inherit(&mut self, before: &mut dyn Task, input: &ControlInput<'_>) {
        match (before as &mut dyn Any).downcast_mut::<Self>() {
            Some(before) => self.tracking.continue_from(&mut before.tracking, input),
            None => self.start(input),
        }
    }

    fn inputs(&self) -> Vec<Signal> {
        self.tracking.streamed_inputs()
    }

    fn stop_for_age_s(&self) -> Option<f64> {
        self.tracking.stop_for_stale_age_s()
    }

    /// A joint row is singular only if the tasks above use the joint.
    fn inversion(&self) -> Inversion {
        Inversion::Damped(JOINTS_SINGULARITY_THRESHOLD)
    }

    fn weights(&self) -> Option<Vector6<f64>> {
        let weights = self.tracking.weights()?;
        let mut rows = Vector6::repeat(1.0);
        rows.iter_mut().zip(weights).for_each(|(row, &weight)| *row = weight);
        Some(rows)
    }

    fn when_limited(&self) -> WhenLimited {
        self.tracking.when_limited()
    }

    fn rows_key(&self) -> String {
        format!("task.{}.joint-tracking.joints", self.name())
    }

    fn kind(&self) -> &'static str {
        "joint-tracking of some joints"
    }

    fn row_names(&self) -> Vec<String> {
        self.joints.iter().map(|&joint| self.tracking.joint_name(joint).to_owned()).collect()
    }

    fn row_unit(&self, row: usize) -> (&'static str, f64) {
        (self.tracking.position_unit(self.joints[row]), 1.0)
    }

    fn reference_speeds(&self) -> [Option<f64>; 2] {
        let speeds =
            self.joints.iter().map(|&joint| self.tracking.kinematic_target_of(joint, 0.0, 0.0).abs());
        [None, speeds.reduce(f64::max)]
    }

    fn gains(&self, row: usize) -> Option<RowGains> {
        let [stiffness_per_s2, damping_per_s] = self.tracking.gains_of(*self.joints.get(row)?);
        Some(RowGains { stiffness_per_s2, damping_per_s, integral_per_s: 0.0 })
    }

    fn slack_signal(&self) -> Signal {
        self.tracking.slack_signal()
    }

    fn spread_slack(&self, rows: &Vector6<f64>, values: &mut [f64]) {
        values.fill(0.0);
        self.joints.iter().zip(rows).for_each(|(&joint, x)| values[joint] = *x);
    }

    fn record(&self, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
        self.tracking.record(signals, out);
    }
}
