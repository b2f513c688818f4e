//! Properties of a robot that a controller needs in addition to the model.

use crate::limits::collision_limits::CollisionLimits;
use crate::limits::horizon::HORIZON_S;
use crate::limits::joint_limits::JointLimits;
use opspace_model::{FrameId, Model};

/// Longest delay that is not predicted, s: with it, a joint exceeds its speed limit by less than 5 % in violent motions.
pub const UNPREDICTED_S: f64 = 0.5 * HORIZON_S;

/// Period, force sensors, gravity compensation, limits and collision geometry of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlContext {
    /// Control period: time between two updates, s.
    pub period_s: f64,
    /// Time from a measurement until the command that is computed from it acts, s; 0 if it is unknown.
    /// If it exceeds 10 ms, torques are computed for the state predicted for that time.
    pub command_delay_s: f64,
    /// Force sensors in the order of [`Measurement::wrenches`](crate::Measurement): name and frame.
    pub sensors: Vec<(String, FrameId)>,
    /// Number of the last sensors whose force is not measured, but estimated from the torques of the motors.
    pub estimated_sensors: usize,
    /// True if the robot itself adds the gravity torques to the commanded torques.
    pub gravity_by_robot: bool,
    /// Limits of the joints.
    pub limits: JointLimits,
    /// Distances that are kept between links and from obstacles; `None` if nothing is known about them. Inverse
    /// kinematics does not keep them.
    pub collision: Option<CollisionLimits>,
}

impl ControlContext {
    /// Context of a robot without force sensors and without gravity compensation of its own, with the limits of its
    /// URDF. `period_s` is the control period, s.
    #[must_use]
    pub fn new(model: &Model, period_s: f64) -> Self {
        let limits = JointLimits::of(model);
        Self {
            period_s,
            command_delay_s: 0.0,
            sensors: Vec::new(),
            estimated_sensors: 0,
            gravity_by_robot: false,
            limits,
            collision: None,
        }
    }

    /// True if torques are computed for the state that is predicted for the time at which they act.
    #[must_use]
    pub fn predicts_state(&self) -> bool {
        self.command_delay_s > UNPREDICTED_S
    }
}

/// Returns index and frame of the force sensors whose wrenches may be added up: sensors of one chain measure the same forces, of
/// which the first counts.
pub fn separate_sensors(model: &Model, sensors: impl IntoIterator<Item = FrameId>) -> Vec<(usize, FrameId)> {
    let carries = |a: FrameId, b: FrameId| {
        model.frame(a).body.is_none_or(|body| model.ancestors(b).any(|ancestor| ancestor == body))
    };
    let mut separate: Vec<(usize, FrameId)> = Vec::new();
    for (index, frame) in sensors.into_iter().enumerate() {
        if !separate.iter().any(|&(_, other)| carries(other, frame) || carries(frame, other)) {
            separate.push((index, frame));
        }
    }
    separate
}

#[cfg(test)]
mod tests {
    use super::*;
    use opspace_model::{Inertia, Joint, JointKind, Limits, Placement};

    /// Compared: sensors on a trunk, its two arms and the base, and those that count.
    #[test]
    fn sensors_of_one_chain_count_once() {
        let mut model = Model::new("two arms");
        let mut add = |parent, name: &str| {
            let joint = Joint { name: name.into(), kind: JointKind::Continuous, limits: Limits::NONE };
            let body = model.add_body(parent, Placement::identity(), joint, Inertia::zero());
            (body, model.add_frame(name, Some(body), Placement::identity()))
        };
        let (trunk, on_trunk) = add(None, "trunk");
        let (left, on_left) = add(Some(trunk), "left");
        let (_, on_left_hand) = add(Some(left), "left_hand");
        let (_, on_right) = add(Some(trunk), "right");
        let counted = |sensors: &[FrameId]| -> Vec<usize> {
            separate_sensors(&model, sensors.iter().copied()).into_iter().map(|(index, _)| index).collect()
        };
        assert_eq!(counted(&[on_left, on_right]), [0, 1]);
        assert_eq!(counted(&[on_left_hand, on_left, on_right]), [0, 2]);
        assert_eq!(counted(&[on_left, on_left]), [0]);
        assert_eq!(counted(&[on_trunk, on_left, on_right]), [0]);
        assert_eq!(counted(&[on_right, on_trunk, on_left]), [0, 2]);
    }
}
