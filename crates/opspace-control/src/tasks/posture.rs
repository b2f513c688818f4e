//! Posture: the joints are pulled to a posture, in the null space of the other tasks.
//!
//! ```text
//! τ = Nᵀ M (ω² (q_0 − q) − 2ζω q̇)
//! ```

use crate::algebra::multiply;
use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::error::ControlError;
use crate::per_joint::indices;
use crate::tasks::build_task::{BuildTask, BuiltTask};
use crate::tasks::joint_parameters::{JointFeedback, JointPostureParameters};
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::{RowGains, TaskInput};
use crate::tasks::when_limited::joint_weights;
use nalgebra::DVector;
use opspace_model::{Data, JointKind, Model};
use std::any::Any;

/// Joint posture task: see [`JointPostureParameters`].
#[derive(Clone, Debug)]
pub struct Posture {
    name: String,
    fixed: Vec<(usize, JointKind, f64)>,
    gains: JointFeedback,
    weights: Option<Vec<f64>>,
    start: DVector<f64>,
    posture: DVector<f64>,
}

impl Posture {
    /// Creates a task from its parameters.
    ///
    /// # Errors
    /// Unknown names, missing values.
    pub fn new(name: &str, parameters: &JointPostureParameters, model: &Model) -> Result<Self, ControlError> {
        let key = format!("task.{name}.joint-posture");
        let joints: Vec<usize> = (0..model.n()).collect();
        let fixed = indices(model, &format!("{key}.posture_rad"), &parameters.posture_rad)?;
        Ok(Self {
            name: name.to_owned(),
            fixed: fixed
                .into_iter()
                .map(|(joint, &value)| (joint, model.joints()[joint].kind, value))
                .collect(),
            gains: JointFeedback::new(
                &parameters.frequency_rad_per_s,
                &parameters.damping_ratio,
                model,
                &key,
            )?,
            weights: joint_weights(&parameters.weight, &joints, model, &format!("{key}.weight"))?,
            start: DVector::zeros(model.n()),
            posture: DVector::zeros(model.n()),
        })
    }

    /// Continues with the posture at the start of the run for joints that are not named.
    fn continue_from(&mut self, before: &Self) {
        self.posture.copy_from(&before.start);
        self.start.copy_from(&before.start);
        self.name_posture();
    }

    fn begin_at(&mut self, q: &DVector<f64>) {
        self.posture.copy_from(q);
        self.start.copy_from(q);
        self.name_posture();
    }

    fn name_posture(&mut self) {
        for &(joint, kind, value) in &self.fixed {
            self.posture[joint] = kind.nearest_turn(value, self.start[joint]);
        }
    }

    fn acceleration(&self, data: &Data, out: &mut [f64]) {
        for (i, a) in out.iter_mut().enumerate() {
            *a = self.gains.stiffness[i] * (self.posture[i] - data.q[i]) - self.gains.damping[i] * data.dq[i];
        }
    }
}

impl BuildTask for JointPostureParameters {
    fn build(&self, name: &str, model: &Model, _context: &ControlContext) -> Result<BuiltTask, ControlError> {
        Ok(BuiltTask::joints(Posture::new(name, self, model)?))
    }

    fn frequency_key(&self) -> Option<&'static [&'static str]> {
        Some(&["frequency_rad_per_s"])
    }
}

impl JointTask for Posture {
    fn name(&self) -> &str {
        &self.name
    }

    fn update(&mut self, input: &TaskInput<'_>, acceleration: &mut [f64], torque: &mut [f64]) {
        let data = input.control.data;
        self.acceleration(data, acceleration);
        multiply(&data.mass_matrix, acceleration, torque);
    }

    fn kinematic_target(
        &self,
        q: &[f64],
        _gain_per_s: f64,
        posture_gain_per_s: f64,
        velocity: &mut [f64],
    ) -> bool {
        for ((v, q0), q) in velocity.iter_mut().zip(&self.posture).zip(q) {
            *v = posture_gain_per_s * (q0 - q);
        }
        true
    }

    fn weights(&self) -> Option<&[f64]> {
        self.weights.as_deref()
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.begin_at(&input.measurement.q);
    }

    fn inherit(&mut self, before: &mut dyn JointTask, input: &ControlInput<'_>) {
        match (before as &mut dyn Any).downcast_mut::<Self>() {
            Some(before) => self.continue_from(before),
            None => self.start(input),
        }
    }

    fn gains(&self, joint: usize, _inertia: f64) -> Option<RowGains> {
        let (stiffness_per_s2, damping_per_s) = (self.gains.stiffness[joint], self.gains.damping[joint]);
        Some(RowGains { stiffness_per_s2, damping_per_s, integral_per_s: 0.0 })
    }

    fn kind(&self) -> &'static str {
        "joint-posture"
    }
}
