//! Bounds on the results of `opspace identify robots/asimo-arm`, read from its output folder, which
//! `OPSPACE_IDENTIFIED` names. `.ci/run acceptance` identifies both profiles, and runs these tests after each of
//! them.
//!
//! Compared: identified parameters and those of the simulation; a run with identified nominal parameters and a run
//! with the true ones.

use crate::cli_common::{opspace, project, read, read_json, scratch};
use serde_json::Value;
use std::io::Write;
use std::path::PathBuf;

const FOLDER: &str = "OPSPACE_IDENTIFIED";

/// Bounds of a profile: relative errors of kp and kv.
fn tolerances(profile: &str) -> [f64; 2] {
    match profile {
        "a-med" => [0.03, 0.03],
        "b-soft" => [0.05, 0.08],
        other => panic!("no bars for profile '{other}'"),
    }
}

/// Returns the folder that the environment variable names, and its identification.
fn identified() -> (PathBuf, Value) {
    let folder = std::env::var_os(FOLDER).map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| panic!("{FOLDER} names no folder of `opspace identify`"));
    let folder = folder.canonicalize().unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let identification = read_json(folder.join("identification.json"));
    assert_eq!(identification["schema"], "opspace.identification/1");
    (folder, identification)
}

fn true_parameters() -> toml::Table {
    read(project("robots/asimo-arm/robot.toml")).parse().expect("TOML")
}

#[test]
#[ignore = "needs the results of an identification, OPSPACE_IDENTIFIED: .ci/run acceptance"]
fn every_joint_is_identified_within_tolerance() {
    let (_, identification) = identified();
    let profile = identification["profile"].as_str().expect("a profile");
    let [kp_bar, kv_bar] = tolerances(profile);
    let truth = true_parameters();
    let believed = truth["profile"][profile].as_table().expect("the profile");
    let delay = believed["delay_servo_ticks"].as_integer().expect("ticks");
    let servos = believed["servo"].as_table().expect("servos");
    let joints = identification["joints"].as_object().expect("joints");
    assert_eq!(joints.len(), servos.len(), "every joint");
    for (name, joint) in joints {
        assert_eq!(joint["no_torque_mode"], Value::Null, "{name}");
        assert_eq!(joint["scale"], "motor-current", "{name}");
        let true_servo = &servos[name]["cascaded"];
        for (key, found, bar) in [("kp_per_s", "kp", kp_bar), ("kv_nms_per_rad", "kv", kv_bar)] {
            let expected = true_servo[key].as_float().expect("a number");
            let found = joint["servo"][found].as_f64().expect("a number");
            assert!((found / expected - 1.0).abs() < bar, "{name}: {key} {found} of {expected}");
        }
        let found = joint["servo"]["delay"].as_i64().expect("ticks");
        assert!((found - delay).abs() <= 1, "{name}: delay {found} of {delay}");
    }
}

/// Torque error (interval means) of cartesian-tracking with a transformer on a robot.
fn torque_error(profile: &str, robot: &str, transformer: &str) -> f64 {
    let scratch = scratch();
    let task = project("tasks/cartesian-tracking.toml");
    let arguments = ["run", &task, "--robot", robot, "--profile", profile];
    let how = ["--transformer", transformer, "--json", "-"];
    let summary = opspace(scratch.path(), &[&arguments[..], &how[..]].concat()).exits(0).json();
    assert_eq!(summary["faulted"], Value::Null);
    summary["metrics"]["torque_error_interval"].as_f64().expect("a number")
}

/// Compared: torque errors with identified and with true nominal parameters: of the emulated servo, and of equation
/// (K10) with gains that are split from the fitted closed loop alone.
#[test]
#[ignore = "needs the results of an identification, OPSPACE_IDENTIFIED: .ci/run acceptance"]
fn identified_parameters_control_like_true_ones() {
    let (folder, identification) = identified();
    let profile = identification["profile"].as_str().expect("a profile");
    let (identified, truth) = (folder.display().to_string(), project("robots/asimo-arm"));
    for (with, without, worse) in
        [("emulation+current", "emulation+current", 1.2), ("identified+current", "paper+current", 1.3)]
    {
        let (believed, known) =
            (torque_error(profile, &identified, with), torque_error(profile, &truth, without));
        let _ = writeln!(std::io::stderr(), "{profile}, {with}: torque error {believed:.4}, {known:.4} true");
        assert!(believed <= worse * known, "{with}: {believed} of {known}");
    }
}
