//! Damping: the joints are damped in proportion to their velocity, in the null space of the other tasks.
//!
//! ```text
//! τ = −Nᵀ D q̇
//! ```

use crate::context::ControlContext;
use crate::error::ControlError;
use crate::tasks::build_task::{BuildTask, BuiltTask};
use crate::tasks::joint_parameters::JointDampingParameters;
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::{RowGains, TaskInput};
use opspace_backend::quantity::NonNegative;
use opspace_model::Model;

/// Joint damping task: see [`JointDampingParameters`].
#[derive(Clone, Debug)]
pub struct Damping {
    name: String,
    /// Damping of each joint, Nms/rad or Ns/m (n).
    damping: Vec<f64>,
}

impl Damping {
    /// Creates a task from its parameters.
    ///
    /// # Errors
    /// Unknown names, missing values.
    pub fn new(name: &str, parameters: &JointDampingParameters, model: &Model) -> Result<Self, ControlError> {
        let key = format!("task.{name}.joint-damping.damping_nms_per_rad");
        let damping = parameters.damping_nms_per_rad.resolve(model, &key)?;
        Ok(Self { name: name.to_owned(), damping: damping.into_iter().map(NonNegative::get).collect() })
    }
}

impl BuildTask for JointDampingParameters {
    fn build(&self, name: &str, model: &Model, _context: &ControlContext) -> Result<BuiltTask, ControlError> {
        Ok(BuiltTask::joints(Damping::new(name, self, model)?))
    }

    fn frequency_key(&self) -> Option<&'static [&'static str]> {
        None
    }
}

impl JointTask for Damping {
    fn name(&self) -> &str {
        &self.name
    }

    fn update(&mut self, input: &TaskInput<'_>, acceleration: &mut [f64], torque: &mut [f64]) {
        let data = input.control.data;
        for ((t, d), dq) in torque.iter_mut().zip(&self.damping).zip(&data.dq) {
            *t = -*d * dq;
        }
        acceleration.copy_from_slice(torque);
        data.mass_matrix_factor.solve(acceleration);
    }

    fn kinematic_target(
        &self,
        _q: &[f64],
        _gain_per_s: f64,
        _posture_gain: f64,
        _velocity: &mut [f64],
    ) -> bool {
        false
    }

    fn gains(&self, joint: usize, inertia: f64) -> Option<RowGains> {
        let damping_per_s = self.damping[joint] / inertia;
        Some(RowGains { stiffness_per_s2: 0.0, damping_per_s, integral_per_s: 0.0 })
    }

    fn kind(&self) -> &'static str {
        "joint-damping"
    }
}
