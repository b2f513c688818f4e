//! Properties of a robot that a controller must know besides its model.

use crate::limits::joint_limits::JointLimits;
use opspace_model::{FrameId, Model};

/// Period, force sensors, gravity compensation and limits of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlContext {
    /// Time from one update to the next, s.
    pub period_s: f64,
    /// Force sensors in the order of [`Measurement::wrenches`](crate::Measurement): name and frame.
    pub sensors: Vec<(String, FrameId)>,
    /// True if the robot adds gravity's torque to the commanded torques.
    pub gravity_by_robot: bool,
    /// Limits of the joints.
    pub limits: JointLimits,
}

impl ControlContext {
    /// A robot without force sensors, whose gravity the controller compensates, with the limits of its URDF. `period_s`
    /// is the time from one update to the next, s.
    #[must_use]
    pub fn new(model: &Model, period_s: f64) -> Self {
        Self { period_s, sensors: Vec::new(), gravity_by_robot: false, limits: JointLimits::of(model) }
    }
}
