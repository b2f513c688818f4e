//! `[driver]` of robot.toml on the command line: what is checked before anything is opened, and what is said about a robot.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{Ran, opspace, project, scratch};
use std::fs;
use tempfile::TempDir;

/// Folder with the files of the SO-101, and its `[driver]` with replacements.
fn so101(replacements: &[(&str, &str)]) -> TempDir {
    let folder = scratch();
    for entry in fs::read_dir(project("examples/so101")).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, folder.path().join(path.file_name().unwrap())).unwrap();
    }
    let robot = folder.path().join("robot.toml");
    let mut text = fs::read_to_string(&robot).unwrap();
    for (from, to) in replacements {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    fs::write(robot, text).unwrap();
    folder
}

/// Calibration of all five joints, as a text to be changed.
const CALIBRATION: &str = r#"{
    "shoulder_pan": {"id": 1, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "shoulder_lift": {"id": 2, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "wrist_flex": {"id": 4, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300},
    "wrist_roll": {"id": 5, "drive_mode": 0, "homing_offset": 0, "range_min": 800, "range_max": 3300}
}"#;

fn check(folder: &TempDir, file: &str) -> Ran {
    opspace(folder.path(), &["check", file])
}

/// What is not there yet, a calibration and a port, is a warning; with both there is none.
#[test]
fn check_warns_of_a_port_and_a_calibration_that_are_absent() {
    let folder = so101(&[("/dev/ttyACM0", "port")]);
    for file in ["hold-and-yield.toml", "robot.toml"] {
        let ran = check(&folder, file).exits(0);
        ran.prints(&["so101.json", "lerobot-calibrate", "port does not exist", "[driver-doubt]", "robot.toml:7"]);
    }
    fs::write(folder.path().join("so101.json"), CALIBRATION).unwrap();
    fs::write(folder.path().join("port"), "").unwrap();
    for file in ["hold-and-yield.toml", "robot.toml"] {
        let ran = check(&folder, file).exits(0);
        assert!(!ran.stdout.contains("driver-doubt"), "{}", ran.stdout);
    }
}

/// Values that the driver would refuse are errors of `check` and of `run`, at their line, before anything is opened or written.
#[test]
fn wrong_settings_of_a_driver_are_errors_at_their_line() {
    let cases: [(&str, &str, &[&str]); 6] = [
        ("i = 0", "i = 0\nbaudrate = 1000000", &["unknown key 'baudrate'", "the keys are: port, baud_hz"]),
        (
            "i = 0",
            "i = 0\ngoal_sped_rad_per_s = 1.0",
            &["unknown key 'goal_sped_rad_per_s'", "did you mean `goal_speed_rad_per_s`?"],
        ),
        ("\np = 16", "\np = 300", &["'p' is the content of a register, a whole number of 0 to 255, not 300"]),
        ("d = 32", "d = \"32\"", &["'d' must be a number, not \"32\""]),
        ("d = 32", "d = 32\nat_end = \"drop\"", &["'at_end' must be \"hold\" or \"lower\", not \"drop\""]),
        ("i = 0", "", &["the key 'i' is missing"]),
    ];
    for (from, to, words) in cases {
        let folder = so101(&[(from, to)]);
        let place = &["robot.toml:"][..];
        for file in ["hold-and-yield.toml", "robot.toml"] {
            check(&folder, file).exits(2).says(words).says(place);
        }
        opspace(folder.path(), &["run", "hold-and-yield.toml"]).exits(2).says(words).says(place);
        assert!(!folder.path().join("runs").exists());
        opspace(folder.path(), &["run", "hold-and-yield.toml", "--simulate", "--duration-s", "0.5"]).exits(0);
    }
}

#[test]
fn wrong_calibrations_are_errors_of_check() {
    let folder = so101(&[]);
    for (from, to, words) in [
        ("\"wrist_flex\"", "\"wrist\"", "has no motor 'wrist_flex' for joint 'wrist_flex'; its motors are:"),
        ("\"range_max\": 3300", "\"range_max\": 800", "range_max is 800"),
        ("{", "", "not a calibration of LeRobot"),
    ] {
        fs::write(folder.path().join("so101.json"), CALIBRATION.replacen(from, to, 1)).unwrap();
        check(&folder, "hold-and-yield.toml").exits(2).says(&[words, "robot.toml:", "so101.json"]);
    }
}

/// The program of a user may have a driver that this one does not have.
#[test]
fn unknown_driver_is_a_problem_with_the_names_of_the_others() {
    let folder = so101(&[("name = \"feetech\"", "name = \"feetec\"")]);
    for file in ["hold-and-yield.toml", "robot.toml"] {
        let words = ["no driver 'feetec'", "did you mean 'feetech'?", "[missing-driver]", "robot.toml:"];
        check(&folder, file).exits(0).prints(&words);
    }
}

/// By hand: twice the gain of a proportional servo is twice its stiffness, 2 · 8.9 Nm/rad.
#[test]
fn gain_that_the_stiffness_does_not_belong_to_is_refused() {
    let folder = so101(&[("\np = 16", "\np = 32")]);
    let words = [
        "p = 32, but the stiffness in [profile], 8.9 Nm/rad, is stated for P = 16; at P = 32 it would be 17.8 Nm/rad",
        "stiffness_at_p = 32, or p = 16",
        "robot.toml:",
    ];
    check(&folder, "hold-and-yield.toml").exits(2).says(&words);
    opspace(folder.path(), &["run", "hold-and-yield.toml"]).exits(2).says(&words);
    let both =
        so101(&[("\np = 16", "\np = 32"), ("at_p = 16", "at_p = 32"), ("stiffness_nm_per_rad = 8.9", "stiffness_nm_per_rad = 17.8")]);
    check(&both, "hold-and-yield.toml").exits(0);
}

#[test]
fn gains_that_the_model_does_not_have_are_warned_of() {
    let folder = so101(&[("\ni = 0", "\ni = 5")]);
    check(&folder, "hold-and-yield.toml").exits(0).prints(&["i = 5, but the servos of [profile] have no integral"]);
    let folder = so101(&[("stiffness_at_p = 16\n", "")]);
    check(&folder, "hold-and-yield.toml").exits(0).prints(&["nothing says for which P", "state stiffness_at_p"]);
}
