//! Commands as messages.

use crate::common::{config, settings, text, texts};
use opspace_backend::Setting;
use opspace_ros2::RosConfig;
use opspace_ros2::commands::{CommandMessage, command_message};
use opspace_ros2::messages::Stamp;

#[test]
fn arrays_have_the_order_of_the_controller() {
    let CommandMessage::Array(message) = command_message(&config(), &[0.1, 0.2]) else { panic!("an array") };
    assert_eq!(message.data, [0.1, 0.2]);
    let turned =
        RosConfig::from_settings(&settings().with("command_joints", texts(&["wrist", "elbow"]))).unwrap();
    let CommandMessage::Array(message) = command_message(&turned, &[0.1, 0.2]) else { panic!("an array") };
    assert_eq!(message.data, [0.2, 0.1]);
}

#[test]
fn trajectories_have_one_point_that_is_reached_after_the_stated_time() {
    let settings = settings()
        .with("command_type", text("joint-trajectory"))
        .with("trajectory_s", Setting::Number(0.02))
        .with("command_joints", texts(&["wrist", "elbow"]));
    let config = RosConfig::from_settings(&settings).unwrap();
    assert_eq!(config.commands, "joint_trajectory_controller/joint_trajectory");
    let CommandMessage::Trajectory(message) = command_message(&config, &[0.1, 0.2]) else {
        panic!("a trajectory")
    };
    assert_eq!(message.joint_names, ["wrist", "elbow"]);
    assert_eq!(message.points.len(), 1);
    assert_eq!(message.points[0].positions, [0.2, 0.1]);
    assert_eq!(message.points[0].time_from_start, Stamp { sec: 0, nanosec: 20_000_000 });
    assert_eq!(message.header.stamp, Stamp::default());
}
