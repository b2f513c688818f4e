//! Notes of runs whose motor torques are far from the desired ones: the transformer to try, and the damping that is left.

use crate::cli_common::{opspace, project, read_json, scratch};

/// Joints, gains known to 30 %, and no motor current.
const UNCERTAIN: [&str; 6] = [
    "--set",
    "robot.interface.measured=[\"position\"]",
    "--set",
    "robot.interface.gears=\"elastic\"",
    "--set",
    "robot.profile.a-med.servo.elbow.cascaded.gain_uncertainty=0.3",
];

/// A transformer with a torque error of a quarter. Checked: the note with the transformer to try and what it gives, which is less;
/// no note with that transformer.
#[test]
fn large_torque_error_names_the_transformer_to_try() {
    let folder = scratch();
    let task = project("tasks/cartesian-tracking.toml");
    let run = ["run", &task, "--duration-s", "3", "--force", "--out", "out", "--transformer"];
    let with = |transformer| opspace(folder.path(), &[&run[..], &[transformer]].concat()).exits(0);
    let words = ["NOTE the torque error is 2", "'paper'", "--transformer emulation+current gives "];
    let noted = with("paper").says(&words);
    assert!(
        read_json(folder.path().join("out/summary.json")).pointer("/metrics/torque_error_interval").is_some()
    );
    let silent = with("emulation+current");
    assert!(!silent.stderr.contains("NOTE the torque error"), "{}", noted.stderr);
}

/// Gains that are known to 30 %. Checked: what the run and its page say of the damping that is left, and of what reduces it.
#[test]
fn damping_that_is_left_is_stated() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    let run = ["run", &task, "--duration-s", "3", "--force", "--out", "out"];
    let words = ["of the servos' damping is left", "±30 %", "`opspace identify` measures", "±3 % leave 3 %"];
    opspace(folder.path(), &[&run[..], &UNCERTAIN].concat()).exits(0).prints(&words);
    let page = std::fs::read_to_string(folder.path().join("out/report.html")).expect("a page");
    assert!(page.contains("damping is left to the joints"), "the page says so");
}
