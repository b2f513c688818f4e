//! Commands for experiments with several robots, as users call them.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{Ran, command, opspace, project, read, read_json, scratch};
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Results of a robot, and of all.
const RESULTS: [&str; 8] = [
    "report.html",
    "summary.json",
    "leader/report.html",
    "leader/summary.json",
    "leader/run.mcap",
    "follower/report.html",
    "follower/summary.json",
    "follower/run.mcap",
];

/// Runs the teleoperation for half a second, without its expectations, which need more.
pub fn run(folder: &Path, more: &[&str]) -> Ran {
    let experiment = project("tasks/experiments/teleop-wall.toml");
    let short = ["run", &experiment, "--duration-s", "0.5", "--set", "settle_s=0.1", "--set", "expect={}"];
    opspace(folder, &[&short, more].concat())
}

/// Compared: the page of a run, and that of its folder; the ticks of the logs, and those that a replay compares.
#[test]
fn folder_of_an_experiment_is_reported_and_replayed() {
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    let ran = run(folder.path(), &["--out", "out", "--json", "-"]).exits(0).json();
    let before = read(at("out/report.html"));
    let reported = opspace(folder.path(), &["report", "out", "--json", "-"]).exits(0).json();
    assert!(read(at("out/report.html")) == before, "the pages differ");
    assert_eq!(reported["couplings"], ran["couplings"]);
    assert_eq!(reported["robots"]["leader"]["metrics"], ran["robots"]["leader"]["metrics"]);
    opspace(folder.path(), &["report", "out", "-o", "page.html"]).exits(0);
    assert!(read(at("page.html")) == before);
    opspace(folder.path(), &["report", "out/leader", "out/follower", "-o", "two.html"]).exits(0);
    opspace(folder.path(), &["report", "out", "out/leader"]).exits(2).says(&["several robots"]);

    let said = opspace(folder.path(), &["replay", "out"]).exits(0).stdout;
    for robot in ["leader", "follower"] {
        assert!(said.contains(&format!("out/{robot}/run.mcap: all 700 ticks are equal")), "{said}");
        assert!(read(at(&format!("out/{robot}/report.html"))).contains("experiment_robot"));
    }
    let json = opspace(folder.path(), &["replay", "out", "--json", "-"]).exits(0).json();
    assert_eq!(json["robots"]["follower"]["ticks_compared"], 700);
    opspace(folder.path(), &["replay", "out", "--set", "seed=2"]).exits(2).says(&["one robot"]);
    opspace(folder.path(), &["replay", "out", "--json", "out/leader/run.mcap"]).exits(2);
    // Without the log of a robot, the experiment can't be rebuilt, but the other log replays.
    fs::remove_file(at("out/leader/run.mcap")).unwrap();
    opspace(folder.path(), &["report", "out"]).exits(2).says(&["0 logs of robot 'leader'"]);
    opspace(folder.path(), &["replay", "out"]).exits(0);
}

/// Checks the files that `--force` removes, of robots too that the new experiment does not have; and a run that was cut off.
#[test]
fn force_replaces_the_results_of_all_robots_and_nothing_else() {
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    run(folder.path(), &["--out", "out"]).exits(0);
    fs::write(at("out/leader/notes.txt"), "mine").unwrap();
    fs::create_dir(at("out/other")).unwrap();
    fs::write(at("out/other/report.html"), "mine").unwrap();
    run(folder.path(), &["--out", "out"]).exits(2).says(&["--force"]);
    run(folder.path(), &["--out", "out", "--force"]).exits(0);
    for kept in ["out/leader/notes.txt", "out/other/report.html"] {
        assert_eq!(read(at(kept)), "mine");
    }
    assert!(RESULTS.iter().all(|name| at("out").join(name).exists()));
    // A run of one robot takes the folder.
    let task = project("tasks/gravity-compensation.toml");
    opspace(folder.path(), &["run", &task, "--duration-s", "2", "--out", "out", "--force"]).exits(0);
    assert!(!at("out/follower").exists() && !at("out/leader/run.mcap").exists());
    // A file of the user with the name of a result is not replaced.
    fs::write(at("out/leader/report.html"), "mine").unwrap();
    run(folder.path(), &["--out", "out", "--force"]).exits(2).says(&["not a result"]);
    assert_eq!(read(at("out/leader/report.html")), "mine");
}

#[test]
fn run_that_was_cut_off_is_replaced_with_force() {
    let folder = scratch();
    let experiment = project("tasks/experiments/teleop-wall.toml");
    let long = ["run", &experiment, "--duration-s", "3000", "--out", "out"];
    let mut child =
        command(folder.path(), &long).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let log = folder.path().join("out/leader/run.mcap");
    let begun = Instant::now();
    // The header of a log is longer than a kilobyte.
    while fs::metadata(&log).map_or(0, |log| log.len()) < 10_000 {
        assert!(begun.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none(), "no log");
        sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    run(folder.path(), &["--out", "out"]).exits(2).says(&["--force"]);
    run(folder.path(), &["--out", "out", "--force"]).exits(0);
}

/// Expectations of the experiment and of a robot's task that no run meets, and ones that every run meets.
#[test]
fn missed_expectation_of_experiment_or_robot_exits_with_1() {
    let folder = scratch();
    for (setting, code, said) in [
        ("expect={ \"hands.tracking_max_m\" = { at_most = 1e-9 } }", 1, "hands.tracking_max_m"),
        ("expect={ \"hands.tracking_max_m\" = { at_most = 1.0 } }", 0, ""),
        ("leader.expect={ \"hand_motion_rms_m\" = { at_least = 10.0 } }", 1, "leader: "),
        ("follower.expect={ \"torque_saturated_share\" = { at_most = 1.0 } }", 0, ""),
    ] {
        let ran = run(folder.path(), &["--out", "out", "--force", "--set", setting]);
        if ran.code == 2 {
            panic!("{setting}: {}", ran.stderr);
        }
        let ran = ran.exits(code).says(&[said]);
        assert!(code == 1 || !ran.stderr.contains("expected"), "{setting}: {}", ran.stderr);
        let summary = read_json(folder.path().join("out/summary.json"));
        let of = |value: &serde_json::Value| value["missed_expectations"].as_array().unwrap().len();
        let missed = of(&summary) + of(&summary["robots"]["leader"]) + of(&summary["robots"]["follower"]);
        assert_eq!(missed, usize::from(code == 1), "{setting}");
    }
}
