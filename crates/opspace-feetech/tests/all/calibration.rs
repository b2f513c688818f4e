//! LeRobot's calibration, and the keys of `[driver]`.

use crate::common::{CALIBRATION, JOINTS, config, file, settings};
use opspace_backend::{CommandKind, ForceSensor, Setting, Settings};
use opspace_feetech::ArmConfig;
use opspace_feetech::calibration::Calibration;
use std::f64::consts::TAU;

fn text(text: &str) -> Setting {
    Setting::Text(text.to_owned())
}

fn refused(change: impl FnOnce(Settings) -> Settings) -> (Option<String>, String) {
    let calibration = file(CALIBRATION);
    let error = ArmConfig::from_settings(&change(settings(&calibration))).expect_err("refused");
    (error.key, error.words)
}

/// By hand: 0 is the middle of the range, and a turn has 4096 counts.
#[test]
fn middle_of_the_range_is_zero() {
    let config = config(|settings| settings);
    let scale = config.servos[0].scale;
    assert!((scale.angle(2045)).abs() < 1e-12);
    assert!((scale.angle(2045 + 1024) - TAU / 4.0).abs() < 1e-12);
    assert_eq!(scale.count(TAU / 4.0), Some((3069, false)));
    assert_eq!(scale.count(3.0), Some((3290, true)));
    assert_eq!(scale.count(f64::NAN), None);
    // Drive mode 1: the other way round.
    let scale = config.servos[2].scale;
    assert!((scale.angle(1925 + 1024) + TAU / 4.0).abs() < 1e-12);
}

#[test]
fn signs_and_zeros_can_be_declared() {
    let config = config(|settings| {
        settings.with("inverted", text("wrist_flex, elbow_flex")).with("zeros_rad", text("0.5, 0, -1"))
    });
    let scales = [0, 1, 2].map(|index| config.servos[index].scale);
    assert_eq!(scales.map(|scale| scale.sign), [1.0, -1.0, 1.0]);
    assert!((scales[0].angle(2045) - 0.5).abs() < 1e-12);
    assert!((scales[2].angle(1925) + 1.0).abs() < 1e-12);
}

#[test]
fn motors_may_have_other_names_than_joints() {
    let calibration = file(CALIBRATION);
    let mut settings = settings(&calibration).with("motors", text("wrist_flex, elbow_flex, shoulder_lift"));
    settings.joints = ["a", "b", "c"].map(str::to_owned).to_vec();
    let config = ArmConfig::from_settings(&settings).expect("a configuration");
    assert_eq!(config.servos.iter().map(|servo| servo.calibration.id).collect::<Vec<_>>(), [4, 3, 2]);
}

#[test]
fn wrong_keys_are_named() {
    let (key, words) = refused(|settings| settings.with("port_name", text("x")));
    assert_eq!(key.as_deref(), Some("port_name"));
    assert!(words.contains("the keys are: port, baud_hz"), "{words}");
    for (name, value, expected) in [
        ("p", Setting::Number(16.5), "a whole number of 0 to 255"),
        ("ids", text("2, 3"), "the robot has 3 joints: shoulder_lift, elbow_flex, wrist_flex"),
        ("ids", text("2, 3, 5"), "the servo of joint 'wrist_flex' has id 4"),
        ("motors", text("wrist_flex, elbow_flex, elbow_flex"), "two joints have the servo with id 3"),
        ("motors", text("wrist, elbow_flex, elbow_flex"), "its motors are: elbow_flex, gripper"),
        ("inverted", text("wrist"), "the joints are: shoulder_lift"),
        ("zeros_rad", text("0, 0, NaN"), "'NaN' is no number"),
        ("silence_s", Setting::Number(0.0), "must be above 0, not 0"),
        ("silence_s", text("0.2"), "must be a number"),
        ("at_end", text("drop"), "\"hold\" or \"lower\""),
        ("calibration", text("/nowhere.json"), "lerobot-calibrate"),
    ] {
        let (_, words) = refused(|settings| settings.with(name, value.clone()));
        assert!(words.contains(expected), "{name}: {words}");
    }
    let (key, _) = refused(|settings| {
        settings
            .with("torque_per_current_nm_per_a", Setting::Number(1.2))
            .with("torque_per_load_nm", Setting::Number(1.9))
    });
    assert_eq!(key.as_deref(), Some("torque_per_load_nm"));
}

#[test]
fn other_commands_and_force_sensors_are_refused() {
    let (_, words) = refused(|mut settings| {
        settings.command = CommandKind::Torque;
        settings
    });
    assert!(words.contains("accept joint positions, not torques"), "{words}");
    let sensor = ForceSensor { name: "wrist".into(), frame: "flange".into() };
    let (_, words) = refused(|settings| settings.with_force_sensors(vec![sensor]));
    assert!(words.contains("no force sensor 'wrist'"), "{words}");
}

#[test]
fn wrong_calibrations_are_named() {
    for (from, to, expected) in [
        ("\"range_max\": 3290", "\"range_max\": 800", "motor 'shoulder_lift': range_max is 800"),
        ("\"drive_mode\": 1", "\"drive_mode\": 2", "motor 'wrist_flex': drive_mode is 2; it must be 0 or 1"),
        ("\"id\": 3", "\"id\": 4", "motors 'elbow_flex' and 'wrist_flex' have the same id 4"),
        ("\"id\": 3", "\"id\": 254", "id is 254; it must be 0 to 253"),
        ("-40", "-4000", "homing_offset is -4000; it must be -2047 to 2047"),
        ("\"id\": 3", "\"ID\": 3", "not a calibration of LeRobot"),
        ("}", "", "not a calibration of LeRobot"),
    ] {
        let error = Calibration::from_json(&CALIBRATION.replacen(from, to, 1)).expect_err(from);
        assert!(error.to_string().contains(expected), "{error}");
    }
    assert_eq!(JOINTS.len(), 3);
}
