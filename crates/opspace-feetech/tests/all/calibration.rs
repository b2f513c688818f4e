//! LeRobot's calibration, and the keys of `[driver]`.

use crate::common::{CALIBRATION, JOINTS, config, file, settings};
use opspace_backend::{CommandKind, ForceSensor, Measured, Setting, Settings};
use opspace_feetech::arm_config::AtEnd;
use opspace_feetech::calibration::Calibration;
use opspace_feetech::{ArmConfig, TorqueSource};
use std::f64::consts::TAU;

fn text(text: &str) -> Setting {
    Setting::Text(text.to_owned())
}

fn texts(values: &[&str]) -> Setting {
    Setting::List(values.iter().map(|value| text(value)).collect())
}

fn numbers(values: &[f64]) -> Setting {
    Setting::List(values.iter().copied().map(Setting::Number).collect())
}

fn table(entries: &[(&str, Setting)]) -> Setting {
    Setting::Table(entries.iter().map(|(joint, value)| ((*joint).to_owned(), value.clone())).collect())
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
        settings
            .with("inverted", texts(&["wrist_flex", "elbow_flex"]))
            .with("zeros_rad", numbers(&[0.5, 0.0, -1.0]))
    });
    let scales = [0, 1, 2].map(|index| config.servos[index].scale);
    assert_eq!(scales.map(|scale| scale.sign), [1.0, -1.0, 1.0]);
    assert!((scales[0].angle(2045) - 0.5).abs() < 1e-12);
    assert!((scales[2].angle(1925) + 1.0).abs() < 1e-12);
}

/// Compared: angles and servos of a table by joint, and those of a list; a joint that the table leaves out has the default.
#[test]
fn values_of_joints_may_be_a_table_by_name() {
    let by_list = config(|settings| settings.with("zeros_rad", numbers(&[0.0, 0.4, 0.0])));
    let by_name =
        config(|settings| settings.with("zeros_rad", table(&[("elbow_flex", Setting::Number(0.4))])));
    assert_eq!(by_list, by_name);
    assert_ne!(by_name.servos[1].scale, config(|settings| settings).servos[1].scale);
    let swapped = [("elbow_flex", text("gripper"))];
    let config = config(|settings| settings.with("motors", table(&swapped)));
    assert_eq!(config.servos.iter().map(|servo| servo.calibration.id).collect::<Vec<_>>(), [2, 6, 4]);
}

#[test]
fn motors_may_have_other_names_than_joints() {
    let calibration = file(CALIBRATION);
    let motors = texts(&["wrist_flex", "elbow_flex", "shoulder_lift"]);
    let mut settings = settings(&calibration).with("motors", motors);
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
        ("ids", numbers(&[2.0, 3.0]), "the robot has 3 joints: shoulder_lift, elbow_flex, wrist_flex"),
        ("ids", numbers(&[2.0, 3.0, 5.0]), "the servo of joint 'wrist_flex' has id 4"),
        ("motors", texts(&["wrist_flex", "elbow_flex", "elbow_flex"]), "two joints have the servo with id 3"),
        ("motors", texts(&["wrist", "elbow_flex", "elbow_flex"]), "its motors are: elbow_flex, gripper"),
        ("inverted", texts(&["wrist"]), "the joints are: shoulder_lift"),
        ("inverted", text("wrist_flex"), "must be an array of strings, not \"wrist_flex\""),
        ("zeros_rad", numbers(&[0.0, 0.0, f64::NAN]), "must have finite numbers"),
        ("zeros_rad", texts(&["0", "0", "0"]), "an array of numbers, or a table by joint, not \"0\""),
        ("zeros_rad", table(&[("wrist", Setting::Number(0.1))]), "the joints are: shoulder_lift"),
        ("zeros_rad", Setting::Number(0.1), "an array of numbers, or a table by joint, not 0.1"),
        ("ids", table(&[("wrist_flex", Setting::Number(5.0))]), "the servo of joint 'wrist_flex' has id 4"),
        ("silence_s", Setting::Number(0.0), "must be above 0, not 0"),
        ("silence_s", text("0.2"), "must be a number"),
        ("at_end", text("drop"), "\"hold\" or \"lower\""),
        ("calibration", text("/nowhere.json"), "lerobot-calibrate"),
    ] {
        let (_, words) = refused(|settings| settings.with(name, value.clone()));
        assert!(words.contains(expected), "{name}: {words}");
    }
}

/// `measured` of `[interface]` decides what samples contain; a constant without it, or it without a constant, is refused.
#[test]
fn measured_motor_torques_need_one_constant() {
    const CURRENT: &str = "torque_per_current_nm_per_a";
    const LOAD: &str = "torque_per_load_nm";
    let measured = |settings: Settings| settings.measuring(&[Measured::Position, Measured::MotorCurrent]);
    let config = config(|settings| measured(settings).with(CURRENT, Setting::Number(1.2)));
    assert_eq!(config.motor_torque, Some(TorqueSource::Current(1.2)));
    let (key, _) = refused(|settings| {
        measured(settings).with(CURRENT, Setting::Number(1.2)).with(LOAD, Setting::Number(1.9))
    });
    assert_eq!(key.as_deref(), Some(LOAD));
    let (_, words) = refused(measured);
    assert!(words.contains("state torque_per_current_nm_per_a or torque_per_load_nm"), "{words}");
    let (key, words) = refused(|settings| settings.with(LOAD, Setting::Number(1.9)));
    assert_eq!(key.as_deref(), Some(LOAD));
    assert!(words.contains("lacks \"motor-current\""), "{words}");
    let (_, words) = refused(|settings| settings.measuring(&[Measured::Position, Measured::JointTorque]));
    assert!(words.contains("measure no joint torques"), "{words}");
}

#[test]
fn arm_is_held_before_the_next_run() {
    let lowered = config(|settings| settings.with("at_end", text("lower")));
    assert!(matches!(lowered.at_end, AtEnd::Lower { .. }));
    let followed = config(|mut settings| {
        settings.is_followed = true;
        settings.with("at_end", text("lower"))
    });
    assert_eq!(followed.at_end, AtEnd::Hold);
}

/// The calibration is beside robot.toml, wherever the program is started.
#[test]
fn relative_calibration_refers_to_the_folder_of_the_robot() {
    let calibration = file(CALIBRATION);
    let folder = calibration.path().parent().expect("a folder");
    let name = calibration.path().file_name().and_then(|name| name.to_str()).expect("a name");
    let settings = settings(&calibration).with("calibration", text(name)).in_folder(folder);
    assert_eq!(ArmConfig::from_settings(&settings).expect("a configuration").servos.len(), JOINTS.len());
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
