//! Exit codes of the program: each row of the table in docs/reference/exit-codes.md.
#![cfg(unix)]

use crate::cli_common::{circle_folder, command, opspace, project, read, scratch};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Causes of the table, with the function that tests each.
const ROWS: &[(&str, fn())] = &[
    ("done; a run may end with a `NOTE`", done),
    ("`STOPPED`: a fault stopped a run", stopped),
    ("`FAILED`: a force task never touched anything, or lost its contact before `settle_s`", never_touched),
    ("`STOPPED` or `FAILED`: more than a tenth of the interface cycles was missed", cycles_missed),
    ("`FAILED`: a joint did not move, although its reference did", joints_held),
    ("`FAILED`: a bound of `expect` was missed", expectation_missed),
    ("the robot could not be reached", crate::driver_faults::blocked_read_ends_by_itself),
    ("one of these in a run of `bench`, or in a robot of an experiment", in_a_suite_and_an_experiment),
    ("`replay` or `log diff` found a difference", difference),
    ("`check --strict` found a problem", strict),
    ("`doctor` found that the machine lacks something for real-time control", lacking),
    ("wrong arguments, or a mistake in a file", bad),
    ("done, but rows were lost, a log is damaged, or a disk is full", damaged),
    ("interrupted: the robot is stopped, and the log is closed", interrupted),
];

/// Runs a task of the project for a short time, with settings.
#[track_caller]
fn exits(task: &str, options: &[&str], code: i32) -> String {
    let folder = scratch();
    let task = project(&format!("tasks/{task}.toml"));
    opspace(folder.path(), &[&["run", &task, "--out", "run"], options].concat()).exits(code).stdout
}

fn done() {
    let text = exits("compliant-x", &["--duration-s", "2", "--set", DROPOUT], 0);
    assert!(text.starts_with("completed 2 s: ") && text.contains("\nNOTE "), "{text}");
}

/// A dropout in a simulated bus after which the robot is held.
const DROPOUT: &str = "robot.simulated.bus.dropouts=[{ at_s = 0.4, duration_s = 0.1 }]";

fn stopped() {
    // The robot is silent for longer than a run goes on.
    let silent = "robot.simulated.bus.dropouts=[{ at_s = 0.3, duration_s = 1.5 }]";
    for controller in ["osc", "ik"] {
        let text =
            exits("joint-tracking", &["--duration-s", "2.5", "--controller", controller, "--set", silent], 1);
        assert!(text.starts_with("STOPPED "), "{text}");
    }
}

fn never_touched() {
    let far = "environment.board.wall.point_m=[0.9, 0.0, 0.0]";
    let text = exits("press-wall", &["--duration-s", "2", "--set", far, "--set", "settle_s=0.5"], 1);
    assert!(text.contains("FAILED ") && text.contains("never touched anything"), "{text}");
}

fn cycles_missed() {
    for controller in ["osc", "ik", "ik-lead"] {
        for (share, code) in [("0.05", 0), ("0.2", 1), ("0.5", 1)] {
            let lost = format!("robot.simulated.bus.lost_cycles_share={share}");
            let text = exits(
                "joint-tracking",
                &["--duration-s", "2", "--controller", controller, "--set", &lost],
                code,
            );
            let has_failed = text.contains("FAILED ") || text.contains("STOPPED ");
            assert_eq!(has_failed, code == 1, "{text}");
            assert!(text.contains("NOTE "), "{text}");
        }
    }
}

fn joints_held() {
    let text = exits(
        "joint-tracking",
        &[
            "--duration-s",
            "2",
            "--backend",
            "torque",
            "--set",
            "robot.simulated.true_over_nominal.friction=200.0",
        ],
        1,
    );
    assert!(text.contains("FAILED ") && text.contains("friction or a brake may hold it"), "{text}");
}

fn expectation_missed() {
    let bound = "expect={ position_max_m = { at_most = 1e-6 } }";
    let text = exits("compliant-x", &["--duration-s", "2", "--set", bound], 1);
    assert!(text.contains("FAILED ") && text.contains("expectation missed"), "{text}");
}

fn in_a_suite_and_an_experiment() {
    let suite = |settings: &str| {
        let folder = circle_folder(&format!(
            "title = \"s\"\n[[run]]\ntasks = [\"circle.toml\"]\noverride = [{settings}]\n"
        ));
        opspace(folder.path(), &["bench", "suite.toml", "--out", "results"]).code
    };
    assert_eq!(suite(""), 0);
    assert_eq!(suite("\"robot.simulated.bus.lost_cycles_share=0.3\""), 1);
    let folder = scratch();
    let teleop = project("tasks/experiments/teleop-free.toml");
    let run = |settings: &[&str]| {
        let options: Vec<&str> = settings.iter().flat_map(|setting| ["--set", *setting]).collect();
        let arguments = [
            &["run", &teleop, "--out", "run", "--force", "--set", "duration_s=1.5", "--set", "expect={}"],
            &options[..],
        ];
        opspace(folder.path(), &arguments.concat())
    };
    run(&[]).exits(0);
    run(&["follower.robot.simulated.bus.lost_cycles_share=0.3"]).exits(1).says(&["follower"]);
}

fn difference() {
    let folder = scratch();
    let run = |name: &str, seed: &str| {
        let task = project("tasks/compliant-x.toml");
        opspace(folder.path(), &["run", &task, "--duration-s", "1.6", "--out", name, "--seed", seed])
            .exits(0);
    };
    run("one", "1");
    run("two", "2");
    opspace(folder.path(), &["log", "diff", "one", "one"]).exits(0);
    opspace(folder.path(), &["log", "diff", "one", "two"]).exits(1);
    opspace(folder.path(), &["replay", "one"]).exits(0);
    opspace(folder.path(), &["replay", "one", "--set", "task.hand.cartesian.gains.frequency_rad_per_s=5.0"])
        .exits(0);
}

fn strict() {
    let task = project("tasks/compliant-x.toml");
    let check = |options: &[&str]| {
        opspace(Path::new("."), &[&["check", &task, "--controller", "ik"], options].concat()).code
    };
    assert_eq!([check(&[]), check(&["--strict"])], [0, 1]);
}

#[cfg(target_os = "linux")]
fn lacking() {
    let folder = scratch();
    let examine = || opspace(folder.path(), &["doctor", "--root", "root", "--duration-s", "0"]);
    // Files that are missing tell nothing.
    let said = examine().exits(0);
    assert!(said.stdout.contains("note     kernel: "), "{}", said.stdout);
    let limits = folder.path().join("root/proc/self");
    std::fs::create_dir_all(&limits).expect("a folder");
    std::fs::write(limits.join("limits"), "Max realtime priority     0     0\n").expect("a file");
    let said = examine().exits(1);
    assert!(said.stdout.contains("missing  priority-limit: "), "{}", said.stdout);
    assert!(said.stdout.contains("/etc/security/limits.d/"), "{}", said.stdout);
}

#[cfg(not(target_os = "linux"))]
fn lacking() {
    opspace(Path::new("."), &["doctor"]).exits(2);
}

fn bad() {
    exits("compliant-x", &["--set", "task.hand.cartesian.damping=20"], 2);
    exits("compliant-x", &["--no-such-option"], 2);
    opspace(Path::new("."), &["run", "no-such-task.toml"]).exits(2);
}

fn damaged() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    opspace(folder.path(), &["run", &task, "--duration-s", "1.6", "--out", "run"]).exits(0);
    let log = folder.path().join("run/run.mcap");
    let bytes = std::fs::read(&log).expect("a log");
    std::fs::write(&log, &bytes[..bytes.len() / 2]).expect("half of it");
    opspace(folder.path(), &["log", "info", "run"]).exits(3);
    opspace(folder.path(), &["report", "run"]).exits(3);
    opspace(folder.path(), &["log", "export", "run", "-o", "rows.csv"]).exits(3);
    // A full disk: `hostile_inputs::full_disk_exits_with_3`.
}

fn interrupted() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    let mut child =
        command(folder.path(), &["run", &task, "--duration-s", "1000", "--out", "run", "--quiet"])
            .stdout(Stdio::null())
            .spawn()
            .expect("it starts");
    // The handler is there before the log.
    while !folder.path().join("run").exists() {
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(200));
    let killed = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().expect("kill");
    assert!(killed.success());
    assert_eq!(child.wait().expect("it ends").code(), Some(130));
    let summary = read(folder.path().join("run/summary.json"));
    assert!(summary.contains("\"interrupted\": true"), "{summary}");
    opspace(folder.path(), &["replay", "run"]).exits(0);
}

/// Compared: the causes in the table and those with a test.
#[test]
fn each_row_of_the_table_has_a_test() {
    let page = read(project("docs/reference/exit-codes.md"));
    let (_, table) = page.split_once("# Exit codes").expect("a section");
    let rows = table.lines().skip_while(|line| !line.starts_with("| code")).skip(2);
    let rows: Vec<&str> = rows.take_while(|line| line.starts_with('|')).collect();
    let causes: Vec<&str> =
        rows.iter().map(|row| row.split('|').nth(2).expect("two columns").trim()).collect();
    let tested: Vec<&str> = ROWS.iter().map(|(cause, _)| *cause).collect();
    assert_eq!(causes, tested);
}

/// Defines a test for each function of [`ROWS`].
macro_rules! tests {
    ($($name:ident $row:ident,)*) => {
        $(
            #[test]
            fn $name() {
                $row();
            }
        )*
    };
}

tests! {
    done_is_0 done,
    stop_is_1 stopped,
    no_touch_is_1 never_touched,
    missed_cycles_are_1 cycles_missed,
    held_joints_are_1 joints_held,
    missed_expectation_is_1 expectation_missed,
    failure_in_a_suite_or_experiment_is_1 in_a_suite_and_an_experiment,
    difference_is_1 difference,
    strict_check_is_1 strict,
    lacking_machine_is_1 lacking,
    mistake_is_2 bad,
    damage_is_3 damaged,
    interruption_is_130 interrupted,
}

/// Compared: the findings of the interface in the summary of a run, and what terminal and page say.
#[test]
fn missed_cycles_and_holds_are_said() {
    let folder = scratch();
    let task = project("tasks/cartesian-tracking.toml");
    let run = |name: &str, settings: &[&str]| {
        let options: Vec<&str> = settings.iter().flat_map(|setting| ["--set", *setting]).collect();
        let arguments =
            [&["run", &task, "--duration-s", "3", "--out", name, "--set", "expect={}"], &options[..]];
        opspace(folder.path(), &arguments.concat()).exits(0).stdout
    };
    let twice =
        "robot.simulated.bus.dropouts=[{ at_s = 1.0, duration_s = 0.1 }, { at_s = 2.0, duration_s = 0.1 }]";
    let text = run("held", &[twice]);
    let said = "the robot was held 2 times";
    assert!(text.contains(said), "{text}");
    assert!(read(folder.path().join("held/report.html")).contains(said));
    let summary = crate::cli_common::read_json(folder.path().join("held/summary.json"));
    let findings = summary["findings"].as_array().expect("a list");
    let finding =
        findings.iter().find(|finding| finding["code"] == "control-interrupted").expect("a finding");
    assert_eq!(finding["numbers"]["holds"], 2.0);
    assert_eq!(finding["numbers"]["missed_cycles"].as_f64(), summary["missed_cycles"].as_f64());
    // Each hold lasts 50 ms at least, and each ramp as long as at the start.
    let held_s = finding["numbers"]["held_s"].as_f64().expect("a number");
    assert!((0.1..1.5).contains(&held_s), "{held_s} s");
    // Outside of the holds, the hand is where it is without any, as far as the holds let it return.
    assert!(!run("whole", &[]).contains("was held"));
    let of = |name: &str| {
        let summary = crate::cli_common::read_json(folder.path().join(name).join("summary.json"));
        summary["metrics"]["position_max_m"].as_f64().expect("a number")
    };
    let (held, whole) = (of("held"), of("whole"));
    assert!(held >= whole, "{held} {whole}");
}

/// Compared: the error at the end of a run that ends while the robot is held, which is absent, and that of one that does not.
#[test]
fn no_final_error_is_from_before_a_hold() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    let ends = |name: &str, at_s: f64| {
        let late = format!("robot.simulated.bus.dropouts=[{{ at_s = {at_s}, duration_s = 0.05 }}]");
        let arguments = ["run", &task, "--duration-s", "2.5", "--out", name, "--set", &late];
        opspace(folder.path(), &arguments).exits(0);
        let summary = crate::cli_common::read_json(folder.path().join(name).join("summary.json"));
        summary["metrics"]["position_final_m"].clone()
    };
    assert!(ends("resumed", 1.6).is_f64());
    assert!(ends("held", 2.42).is_null());
}
