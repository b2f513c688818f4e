//! Couplings of joints, and of different robots.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::{CoupledRun, load, project, run};
use std::fs;

const ASIMO: &str = r#"
robot = "ROBOTS/asimo-arm"
duration_s = 2.0
priority = ["hand", "rest"]
friction_compensation = { gain = 0.8, observer_rad_per_s = 60.0 }
start_rad = { shoulder_pitch = -0.45, shoulder_roll = -0.35, shoulder_yaw = 0.25, elbow = -1.35 }
[task.hand.coupled]
COUPLED
[task.rest.joint-posture]
frequency_rad_per_s = 6.325
damping_ratio = 0.79
"#;
const OPERATOR: &str = r#"
[environment.operator.spring]
frame = "hand"
stiffness_n_per_m = 500.0
damping_ns_per_m = 10.0
motion.scripted = { reach = [{ at_s = 0.3, duration_s = 0.7, by_m = [0.03, 0.0, -0.04] }] }
"#;
const PANDA: &str = r#"
robot = "ROBOTS/panda"
duration_s = 2.0
priority = ["hand", "rest"]
friction_compensation = { gain = 0.8 }
start_rad = { joint1 = 0.0, joint2 = -0.7854, joint3 = 0.0, joint4 = -2.3562, joint5 = 0.0, joint6 = 1.5708, joint7 = 0.7854 }
[task.hand.coupled]
frame = "flange"
COUPLED
[task.rest.joint-posture]
frequency_rad_per_s = 6.325
damping_ratio = 1.0
"#;
const UR5E: &str = r#"
robot = "ROBOTS/ur5e"
duration_s = 2.0
priority = ["hand", "rest"]
friction_compensation = { gain = 0.8 }
start_rad = START
[task.hand.coupled]
frame = "flange"
sensor = "wrist"
COUPLED
[task.rest.joint-posture]
frequency_rad_per_s = 6.325
damping_ratio = 1.0
"#;
const EXPERIMENT: &str = r#"
duration_s = 2.0
settle_s = 0.1
robots.leader.task = "leader.toml"
robots.follower.task = "follower.toml"
[couplings.hands]
leader = { robot = "leader", task = "hand" }
follower = { robot = "follower", task = "hand" }
LAW
"#;

/// Start of the UR5e in the project's task, as text.
fn ur5e_start() -> String {
    let text = fs::read_to_string(project("tasks/ur5e-reach.toml")).unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("start_rad = ")).unwrap();
    line.to_owned()
}

fn coupled(leader: &str, follower: &str, law: &str) -> CoupledRun {
    let folder = tempfile::tempdir().unwrap();
    let robots = project("robots").canonicalize().unwrap().display().to_string();
    for (name, text) in [("leader", leader), ("follower", follower)] {
        let text = text.replace("ROBOTS", &robots).replace("START", &ur5e_start());
        fs::write(folder.path().join(format!("{name}.toml")), text).unwrap();
    }
    let file = folder.path().join("experiment.toml");
    fs::write(&file, EXPERIMENT.replace("LAW", law)).unwrap();
    run(&load(&file, &[]))
}

/// Compared: distance of the two robots' joints, and the friction of an arm over the stiffness of the coupling: below 3 Nm with
/// 0.8 of it compensated, over 100 Nm/rad, doubled.
#[test]
fn joints_of_two_arms_are_coupled() {
    const BOUND_RAD: f64 = 0.02;
    let joints = "joints = [\"shoulder_pitch\", \"elbow\"]";
    for reflect in ["position", "controller-force"] {
        let law = format!(
            "teleoperation = {{ reflect = \"{reflect}\", stiffness_nm_per_rad = 100.0, damping_nms_per_rad = 2.0 }}"
        );
        let task = ASIMO.replace("COUPLED", joints);
        let run = coupled(&(task.clone() + OPERATOR), &task, &law);
        assert!(!run.summary.has_failed(), "{reflect}: {:?}", run.summary.failures());
        let metrics = &run.summary.couplings["hands"];
        let apart = metrics.tracking_max_m.unwrap_or(f64::NAN);
        assert!(apart < BOUND_RAD, "{reflect}: {apart} rad");
        let end = run.hand("leader", "displacement", 1.9, 2.0);
        let moved = end[0].1.iter().fold(0.0, |most: f64, angle| most.max(angle.abs()));
        assert!(moved > 2.0 * BOUND_RAD, "{reflect}: the leader moved by {moved} rad");
    }
}

/// Compared: displacement of the follower in its own rotated axes, and that of the leader.
#[test]
fn different_robots_are_coupled() {
    const BOUND_M: f64 = 5e-3;
    let leader = ASIMO.replace("COUPLED", "frame = \"hand\"\nsensor = \"wrist\"") + OPERATOR;
    let turned = "axes_rpy_rad = [0.0, 0.0, 1.5708]";
    for (follower, sensor, reflect) in [
        (PANDA, "sensor = \"contact\"\n", "measured-force"),
        (PANDA, "", "position"),
        (UR5E, "", "measured-force"),
        (UR5E, "", "controller-force"),
    ] {
        let law = format!("teleoperation = {{ reflect = \"{reflect}\" }}");
        let run = coupled(&leader, &follower.replace("COUPLED", &format!("{sensor}{turned}")), &law);
        let name = format!("{} {reflect}", run.summary.robots["follower"].robot);
        assert!(!run.summary.has_failed(), "{name}: {:?}", run.summary.failures());
        let metrics = &run.summary.couplings["hands"];
        let apart = metrics.tracking_max_m.unwrap_or(f64::NAN);
        assert!(apart < BOUND_M, "{name}: {apart} m");
        let end = run.hand("leader", "displacement", 1.9, 2.0);
        assert!(end[0].1.iter().map(|x| x * x).sum::<f64>().sqrt() > 3.0 * BOUND_M, "{name}: {end:?}");
    }
}
