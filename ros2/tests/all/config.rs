//! Keys of `[driver]`.

use crate::common::{settings, text, texts};
use opspace_backend::{CommandKind, ForceSensor, Measured, Setting, Settings};
use opspace_ros2::RosConfig;
use opspace_ros2::config::{ClockSource, CommandType, EffortMeaning, KEYS};
use std::time::Duration;

#[test]
fn defaults_are_those_of_the_readme() {
    let config = RosConfig::from_settings(&settings().with("domain", Setting::Number(7.0))).unwrap();
    assert_eq!((config.place.domain, config.place.namespace.as_str()), (7, "/"));
    assert_eq!(config.states, "joint_states");
    assert_eq!(config.commands, "forward_position_controller/commands");
    assert_eq!((config.states_reliable, config.commands_reliable), (false, true));
    assert_eq!((config.clock, config.command_type), (ClockSource::Stamp, CommandType::Float64MultiArray));
    assert_eq!(config.silence, Duration::from_millis(100));
    let readme = include_str!("../../README.md");
    for key in KEYS {
        assert!(readme.contains(&format!("| `{key}` |")), "the README lacks the key {key}");
    }
}

#[test]
fn names_are_resolved_in_the_namespace() {
    let config = RosConfig::from_settings(&settings().with("namespace", text("/left/arm/"))).unwrap();
    assert_eq!(config.whole_name("joint_states"), "/left/arm/joint_states");
    assert_eq!(config.whole_name("/joint_states"), "/joint_states");
}

#[test]
fn wrong_keys_are_named_with_what_is_allowed() {
    let number = Setting::Number;
    for (key, value, words) in [
        ("topic", text("x"), "unknown key 'topic'; the keys are: domain"),
        ("domain", number(233.0), "'domain' must be a whole number of 0 to 232, not 233"),
        ("node", text("1st"), "are no namespace and name of a node of ROS 2"),
        ("states", text("joint states"), "'joint states' is no name of a topic of ROS 2"),
        ("clock", text("steady"), "'clock' must be \"stamp\" or \"arrival\", not \"steady\""),
        (
            "states_qos",
            text("sensor"),
            "'states_qos' must be \"reliable\" or \"best-effort\", not \"sensor\"",
        ),
        ("command_joints", texts(&["elbow"]), "joint 'wrist' is missing"),
        ("command_joints", texts(&["elbow", "hand"]), "unknown joint 'hand'; the joints are: elbow, wrist"),
        ("wrenches", texts(&["a", "b"]), "'wrenches' has 2 topics, robot.toml has 1 force sensors: tip"),
        ("trajectory_s", number(0.1), "'trajectory_s' is for command_type = \"joint-trajectory\""),
        ("silence_s", number(0.0), "'silence_s' must be above 0, not 0"),
        ("not_following_rad", number(-1.0), "'not_following_rad' must be above 0, or 0 for never"),
        ("output_hz", number(-1.0), "'output_hz' must be above 0, not -1"),
    ] {
        let error = RosConfig::from_settings(&settings().with(key, value)).expect_err(key);
        assert!(error.words.contains(words), "{key}: {}", error.words);
        assert_eq!(error.key.as_deref(), Some(key));
    }
}

#[test]
fn each_kind_of_command_has_its_defaults_and_an_arm_that_would_fall_is_refused() {
    let joints = vec!["elbow".to_owned()];
    let torque = Settings::new(CommandKind::Torque, joints.clone(), 0.01);
    let error = RosConfig::from_settings(&torque).expect_err("a torque interface without brakes");
    assert_eq!(error.key.as_deref(), Some("zero_effort_holds"));
    let stated = RosConfig::from_settings(&torque.with("zero_effort_holds", Setting::Flag(true))).unwrap();
    assert_eq!(stated.commands, "forward_effort_controller/commands");
    assert_eq!(stated.not_following, Some(20.0));
    let velocity = Settings::new(CommandKind::Velocity, joints, 0.01);
    let never = velocity.clone().with("not_following_rad_per_s", Setting::Number(0.0));
    assert_eq!(RosConfig::from_settings(&never).unwrap().not_following, None);
    assert_eq!(RosConfig::from_settings(&velocity).unwrap().commands, "forward_velocity_controller/commands");
    let trajectory = velocity.with("command_type", text("joint-trajectory"));
    let error = RosConfig::from_settings(&trajectory).expect_err("velocities as a trajectory");
    assert_eq!(error.key.as_deref(), Some("command_type"));
}

#[test]
fn efforts_are_read_if_and_only_if_they_are_measured() {
    let measuring = |measured: &[Measured]| settings().measuring(measured);
    for (settings, words) in [
        (measuring(&[Measured::MotorCurrent]), "has motor-current: state effort = \"motor-torque\""),
        (measuring(&[Measured::JointTorque]), "has joint-torque: state effort = \"joint-torque\""),
        (
            measuring(&[]).with("effort", text("motor-torque")),
            "effort = \"motor-torque\" needs \"motor-current\" in 'measured'",
        ),
    ] {
        let error = RosConfig::from_settings(&settings).expect_err(words);
        assert_eq!(error.key.as_deref(), Some("effort"));
        assert!(error.words.contains(words), "{}", error.words);
    }
    let stated = measuring(&[Measured::MotorCurrent]).with("effort", text("motor-torque"));
    assert_eq!(RosConfig::from_settings(&stated).unwrap().effort, Some(EffortMeaning::MotorTorque));
}

#[test]
fn a_sensor_needs_its_topic() {
    let sensor = vec![ForceSensor { name: "tip".to_owned(), frame: "tool".to_owned() }];
    let settings =
        Settings::new(CommandKind::Position, vec!["elbow".to_owned()], 0.01).with_force_sensors(sensor);
    let error = RosConfig::from_settings(&settings).expect_err("no topic");
    assert!(error.words.contains("has 0 topics"), "{}", error.words);
}
