//! Exactly singular starts with a goal along the lost direction: reported before and after the run.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{opspace, project, scratch};
use std::fs;

/// A straight arm along x and a goal along x; a second start, with a bent elbow, is regular.
const TASK: &str = "
duration_s = 3.0
settle_s = 0.2
priority = [\"tip\"]
start_rad = { shoulder = 0.0, elbow = ELBOW }
[task.tip.cartesian]
frame = \"tip\"
axes = { x = \"motion\", z = \"motion\" }
gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }
reference.point-to-point = { position = { offset_m = [-0.1, 0.0, 0.0] }, duration_s = 1.0 }
";

/// Checks what `check` and `run` say about the task at a start with a straight and with a bent elbow.
#[test]
fn arm_stuck_at_its_singular_start_is_reported() {
    let folder = scratch();
    let robot = format!("robot = {:?}\n", project("robots/planar-2-link"));
    for (elbow, stuck) in [("0.0", true), ("0.6", false)] {
        fs::write(folder.path().join("task.toml"), robot.clone() + &TASK.replace("ELBOW", elbow)).unwrap();
        let checked = opspace(folder.path(), &["check", "task.toml"]);
        let predicted =
            ["task 'tip': at the start it cannot be moved along x", "it leaves late, or not at all"];
        assert!(predicted.iter().all(|words| checked.stdout.contains(words) == stuck), "{}", checked.stdout);
        for backend in ["torque", "position"] {
            let options =
                ["run", "task.toml", "--backend", backend, "--json", "-", "--force", "--out", "run"];
            let summary = opspace(folder.path(), &options).exits(0).json();
            assert_eq!(summary["escapes"].as_array().unwrap().len(), 0, "{backend}");
            let unreached = summary["unreached_goals"].as_array().unwrap();
            assert_eq!(unreached.len(), usize::from(stuck), "{backend}: {unreached:?}");
            if let Some(goal) = unreached.first() {
                assert_eq!((&goal["task"], &goal["singular_along"]), (&"tip".into(), &"x".into()), "{goal}");
                assert!(goal["end_s"].is_null(), "until the end: {goal}");
            }
        }
    }
}

/// With the option, `check` says that the arm leaves the pose, and the run reaches the goal and states the escape; without it,
/// `check` names the option.
#[test]
fn arm_leaves_its_singular_start_if_its_file_says_so() {
    let folder = scratch();
    let task = format!("robot = {:?}\n", project("robots/planar-2-link")) + &TASK.replace("ELBOW", "0.0");
    fs::write(folder.path().join("task.toml"), &task).unwrap();
    let checked = opspace(folder.path(), &["check", "task.toml"]);
    let remedy = "or set task.tip.cartesian.escape = \"nullspace-step\"";
    assert!(checked.stdout.contains(remedy), "{}", checked.stdout);
    let option = task.replace("frame =", "escape = \"nullspace-step\"\nframe =");
    fs::write(folder.path().join("task.toml"), option).unwrap();
    let checked = opspace(folder.path(), &["check", "task.toml"]);
    let says = |words: &str| checked.stdout.contains(words);
    assert!(
        says("it leaves towards a goal") && !says("it leaves late") && !says(remedy),
        "{}",
        checked.stdout
    );
    for backend in ["torque", "position"] {
        let options = ["run", "task.toml", "--backend", backend, "--json", "-", "--force", "--out", "run"];
        let run = opspace(folder.path(), &options).exits(0);
        let summary = run.json();
        let unreached = summary["unreached_goals"].as_array().unwrap();
        assert!(unreached.iter().all(|goal| goal["end_s"].is_number()), "{backend}: {unreached:?}");
        let [escape] = &summary["escapes"].as_array().unwrap()[..] else { panic!("{backend}: {summary}") };
        assert_eq!(escape["task"], "tip", "{escape}");
        let [begin_s, duration_s] = ["begin_s", "duration_s"].map(|key| escape[key].as_f64().unwrap());
        assert!((0.5..2.0).contains(&begin_s) && (0.05..2.0).contains(&duration_s), "{escape}");
    }
    let page = fs::read_to_string(folder.path().join("run/report.html")).unwrap();
    assert!(page.contains("escaped from a singular pose"));
}
