//! Commands of the node as messages.

use crate::config::{CommandType, RosConfig};
use crate::messages::{
    Float64MultiArray, Header, JointTrajectory, JointTrajectoryPoint, MultiArrayLayout, Stamp,
};

/// Command as a message.
#[derive(Clone, Debug, PartialEq)]
pub enum CommandMessage {
    /// Command of a `forward_command_controller`.
    Array(Float64MultiArray),
    /// Trajectory of one point.
    Trajectory(JointTrajectory),
}

/// Returns the message of a command, whose values are in the order of the joints (n).
#[must_use]
pub fn command_message(config: &RosConfig, values: &[f64]) -> CommandMessage {
    let ordered = |numbers: &[usize]| numbers.iter().map(|joint| values[*joint]).collect();
    match config.command_type {
        CommandType::Float64MultiArray => CommandMessage::Array(Float64MultiArray {
            layout: MultiArrayLayout::default(),
            data: ordered(&config.command_order),
        }),
        CommandType::JointTrajectory(time) => CommandMessage::Trajectory(JointTrajectory {
            // Without a stamp it begins when it arrives.
            header: Header::default(),
            joint_names: config.command_order.iter().map(|joint| config.joints[*joint].clone()).collect(),
            points: vec![JointTrajectoryPoint {
                positions: ordered(&config.command_order),
                time_from_start: Stamp::from_seconds(time.as_secs_f64()),
                ..JointTrajectoryPoint::default()
            }],
        }),
    }
}
