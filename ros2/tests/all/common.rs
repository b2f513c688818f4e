//! Settings and messages of a robot with two joints.

use opspace_backend::{CommandKind, ForceSensor, Setting, Settings};
use opspace_ros2::RosConfig;
use opspace_ros2::messages::{Header, JointState, Stamp};

/// Settings of a position robot with a force sensor, at 100 Hz.
pub fn settings() -> Settings {
    let joints = vec!["elbow".to_owned(), "wrist".to_owned()];
    Settings::new(CommandKind::Position, joints, 0.01)
        .with_force_sensors(vec![ForceSensor { name: "tip".to_owned(), frame: "tool".to_owned() }])
        .with("wrenches", texts(&["tip/wrench"]))
}

pub fn text(value: &str) -> Setting {
    Setting::Text(value.to_owned())
}

pub fn texts(values: &[&str]) -> Setting {
    Setting::List(values.iter().map(|value| text(value)).collect())
}

pub fn config() -> RosConfig {
    RosConfig::from_settings(&settings()).unwrap()
}

/// State of other joints too, in another order, at a stamp (s).
pub fn message(stamp_s: f64, elbow: f64, wrist: f64) -> JointState {
    JointState {
        header: Header { stamp: Stamp::from_seconds(stamp_s), frame_id: String::new() },
        name: ["gripper", "wrist", "elbow"].map(str::to_owned).into(),
        position: vec![9.0, wrist, elbow],
        velocity: vec![0.0, 10.0 * wrist, 10.0 * elbow],
        effort: vec![0.0, 100.0 * wrist, 100.0 * elbow],
    }
}
