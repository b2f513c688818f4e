//! The command line as users see it: output, where it is written, and exit code.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use crate::cli_common::{ROOT, command, opspace, project, read, read_json, run, scratch};
use opspace_log::Recording;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

const COMMANDS: [&str; 11] =
    ["run", "bench", "merge", "replay", "report", "log", "check", "model", "new", "schema", "completion"];

/// Keys that a summary and a row of bench always contain.
const ROW: [&str; 14] = [
    "task",
    "robot",
    "backend",
    "controller",
    "transformer",
    "profile",
    "ratio",
    "seed",
    "duration_s",
    "overrides",
    "faulted",
    "fault_time_s",
    "metrics",
    "timing",
];
const METRICS: [&str; 11] = [
    "position_rms_m",
    "position_max_m",
    "orientation_rms_rad",
    "orientation_max_rad",
    "joint_rms_rad",
    "force_rms_n",
    "hand_force_rms_n",
    "hand_motion_rms_m",
    "torque_error_servo",
    "torque_error_interval",
    "torque_error_tick",
];
const TIMING: [&str; 4] = ["tick_ns_median", "tick_ns_p99", "tick_ns_max", "realtime_factor"];

#[track_caller]
fn assert_row(row: &Value) {
    for (keys, of) in [(&ROW[..], row), (&METRICS, &row["metrics"]), (&TIMING, &row["timing"])] {
        let object = of.as_object().unwrap();
        assert!(keys.iter().all(|key| object.contains_key(*key)), "{keys:?}: {of}");
    }
}

fn task(name: &str) -> String {
    project(&format!("tasks/{name}.toml"))
}

#[test]
fn help_of_every_command_fits_the_terminal() {
    let folder = scratch();
    let top = opspace(folder.path(), &["--help"]).exits(0).stdout;
    for name in COMMANDS {
        assert!(top.contains(&format!("  {name} ")), "{name} is missing:\n{top}");
        let help = opspace(folder.path(), &[name, "--help"]).exits(0);
        assert!(help.stdout.contains(&format!("Usage: opspace {name}")) && help.stderr.is_empty());
        let longest = help.stdout.lines().map(|line| line.chars().count()).max().unwrap();
        assert!(longest <= 100, "{name}: {longest} columns");
    }
    for code in ["0 ", "1 ", "2 ", "3 ", "130 "] {
        assert!(top.lines().any(|line| line.trim_start().starts_with(code)), "exit code {code}:\n{top}");
    }
}

#[test]
fn invalid_arguments_exit_with_2_and_a_tip() {
    let folder = scratch();
    let task = task("compliant-x");
    opspace(folder.path(), &[]).exits(2);
    opspace(folder.path(), &["runn"]).exits(2).says(&["'run'"]);
    opspace(folder.path(), &["run"]).exits(2).says(&["<TASK>"]);
    opspace(folder.path(), &["run", &task, "--backend", "torq"])
        .exits(2)
        .says(&["position, velocity, torque"]);
    for seconds in ["0", "-1", "nan", "inf", "abc"] {
        opspace(folder.path(), &["run", &task, "--duration-s", seconds]).exits(2).says(&["seconds above 0"]);
    }
    opspace(folder.path(), &["run", &task, "-v", "-q"]).exits(2).says(&["cannot be used with"]);
    opspace(folder.path(), &["bench", "--jobs", "0"]).exits(2).says(&["--jobs"]);
    let ik = ["run", &task, "--backend", "torque", "--controller", "ik"];
    opspace(folder.path(), &ik).exits(2).says(&["'ik'", "--controller osc"]);
    let profile = ["run", &task, "--profile", "a-mad"];
    opspace(folder.path(), &profile).exits(2).says(&[
        "no profile 'a-mad'",
        "did you mean 'a-med'?",
        "b-soft",
    ]);
    assert!(fs::read_dir(folder.path()).unwrap().next().is_none(), "nothing was written");
}

#[test]
fn run_writes_log_report_summary_and_prints_table() {
    let folder = scratch();
    let ran = opspace(folder.path(), &["run", &task("compliant-x"), "--duration-s", "2"]).exits(0);
    let out = folder.path().join("runs/compliant-x-asimo-arm-position");
    assert!(
        ran.stdout.contains("position osc + emulation+current") && ran.stdout.contains("a-med 1:5"),
        "{}",
        ran.stdout
    );
    assert!(!ran.stdout.contains('\u{1b}') && !ran.stderr.contains('\u{1b}'), "no colours in a pipe");
    ran.says(&["wrote runs/compliant-x-asimo-arm-position/run.mcap"]);
    assert!(Recording::read(out.join("run.mcap")).unwrap().damage.is_none());
    assert!(read(out.join("report.html")).contains("<figure "));
    let summary = read_json(out.join("summary.json"));
    assert_row(&summary);
    assert_eq!(summary["faulted"], Value::Null);
    assert!(summary["metrics"]["hand_force_rms_n"].as_f64().unwrap() > 0.0);
    assert_eq!(summary["metrics"]["orientation_rms_rad"], Value::Null, "the arm has no orientation axes");
}

#[test]
fn summary_states_selected_options() {
    let folder = scratch();
    let set = "task.hand.gains.damping_ratio=0.7";
    let options = ["--backend", "torque", "--profile", "b-soft", "--seed", "9", "--set", set];
    let log = run(folder.path(), "out", "cartesian-tracking", &options);
    let summary = read_json(log.with_file_name("summary.json"));
    let text = |key: &str| summary[key].as_str().unwrap_or("none").to_owned();
    let names = ["task", "robot", "backend", "controller", "transformer", "profile"].map(text);
    assert_eq!(names, ["cartesian-tracking", "asimo-arm", "torque", "osc", "none", "b-soft"]);
    assert_eq!((summary["seed"].as_u64(), summary["duration_s"].as_f64()), (Some(9), Some(2.0)));
    assert_eq!(summary["overrides"], serde_json::json!([set]));
    let recording = Recording::read(log).unwrap();
    let attached = &recording.attachment("task.toml").unwrap().data;
    assert!(
        String::from_utf8_lossy(attached).contains("damping_ratio = 0.7"),
        "the task that ran is in the log"
    );
}

/// Runs with the same file, seed and binary have the same bits in all signals except wall-clock time; runs with
/// another seed have other bits.
#[test]
fn run_is_reproducible() {
    let folder = scratch();
    let recording = |name: &str, options: &[&str]| {
        Recording::read(run(folder.path(), name, "compliant-x", options)).unwrap()
    };
    let (first, again, other) = (recording("a", &[]), recording("b", &[]), recording("c", &["--seed", "2"]));
    let mut differs = false;
    for (index, channel) in first.channels.iter().enumerate() {
        assert!(channel.len() > 1900);
        for signal in channel.layout.signals.iter().filter(|_| channel.layout.channel != "timing") {
            let bits = |recording: &Recording| -> Vec<u64> {
                let column = recording.channels[index].signal(&signal.name).unwrap();
                column.rows().flatten().map(|value| value.to_bits()).collect()
            };
            assert!(bits(&first) == bits(&again), "{} of {}", signal.name, channel.layout.channel);
            differs |= bits(&first) != bits(&other);
        }
    }
    assert!(differs, "the seed does something");
}

#[test]
fn json_goes_to_file_or_replaces_table() {
    let folder = scratch();
    let task = task("joint-tracking");
    let run = ["run", &task, "--duration-s", "2", "--json"];
    let printed = opspace(folder.path(), &[&run[..], &["-"]].concat()).exits(0).json();
    let ran = opspace(folder.path(), &[&run[..], &["row.json", "--out", "b"]].concat()).exits(0);
    assert!(ran.stdout.contains("joint"), "the table is there as well");
    let apart = |mut summary: Value| {
        summary["timing"] = Value::Null;
        summary
    };
    let written = apart(read_json(folder.path().join("row.json")));
    assert_eq!(apart(printed), written);
    assert_eq!(written, apart(read_json(folder.path().join("b/summary.json"))));
}

#[test]
fn previous_run_is_moved_aside_with_notice() {
    let folder = scratch();
    let run = |seed: &str| {
        let task = task("gravity-compensation");
        opspace(folder.path(), &["run", &task, "--duration-s", "1.6", "--seed", seed]).exits(0)
    };
    let seed =
        |name: &str| read_json(folder.path().join("runs").join(name).join("summary.json"))["seed"].clone();
    assert!(!run("1").stderr.contains("previous"));
    run("2").says(&["moved", "runs/gravity-compensation-asimo-arm-position.previous"]);
    run("3").says(&["runs/gravity-compensation-asimo-arm-position.previous-2"]);
    assert_eq!(seed("gravity-compensation-asimo-arm-position"), 3);
    assert_eq!(seed("gravity-compensation-asimo-arm-position.previous"), 1);
    assert_eq!(seed("gravity-compensation-asimo-arm-position.previous-2"), 2);
}

#[test]
fn requested_folder_is_replaced_only_by_force() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let before = fs::read(&log).unwrap();
    let note = log.with_file_name("note.txt");
    fs::write(&note, "mine").unwrap();
    let task = task("compliant-x");
    let again = ["run", &task, "--duration-s", "2", "--seed", "2", "--out", "out"];
    opspace(folder.path(), &again).exits(2).says(&["out", "already contains a run", "--force"]);
    assert!(fs::read(&log).unwrap() == before, "the log is as it was");
    opspace(folder.path(), &[&again[..], &["--force"]].concat()).exits(0);
    assert!(fs::read(&log).unwrap() != before);
    assert_eq!(read(note), "mine");
    opspace(folder.path(), &[&again[..7], &["out/note.txt"]].concat()).exits(2).says(&["note.txt"]);
}

#[test]
fn quiet_prints_only_results() {
    let folder = scratch();
    let arguments = ["run", &task("compliant-x"), "--duration-s", "2", "-q"];
    let ran = opspace(folder.path(), &arguments).exits(0);
    assert_eq!((ran.stdout.as_str(), ran.stderr.as_str()), ("runs/compliant-x-asimo-arm-position\n", ""));
    let bound = "expect={ position_max_m = { at_most = 1e-6 } }";
    let failing = [&arguments[..], &["--force", "--set", bound]].concat();
    let ran = opspace(folder.path(), &failing).exits(1);
    let lines: Vec<&str> = ran.stdout.lines().collect();
    assert!(lines[0].starts_with("FAILED ") && lines[0].contains("expectation missed"), "{lines:?}");
    assert_eq!(lines[1..], ["runs/compliant-x-asimo-arm-position"]);
}

/// Checks that the result comes first, that joints are in the order of the robot, that no line of a table is long, and that
/// footnotes need `-v`.
#[test]
fn result_of_a_run_comes_first() {
    let folder = scratch();
    let run = |options: &[&str]| {
        let task = task("compliant-x");
        let run = ["run", &task, "--duration-s", "2", "--force", "--out", "out"];
        opspace(folder.path(), &[&run, options].concat()).exits(0).stdout
    };
    let said = run(&[]);
    let (first, rest) = said.split_once('\n').unwrap();
    assert!(first.starts_with("completed 2 s: the operator moves the arm by "), "{first}");
    assert!(rest.lines().next().unwrap().contains("hand within "), "{said}");
    assert!(said.ends_with("\n`-v` explains the columns and what the values are based on\n"), "{said}");
    let place = |text: &str| said.find(text).unwrap();
    assert!(
        place("\n shoulder_pitch ") < place("\n shoulder_roll ")
            && place("\n shoulder_yaw ") < place("\n elbow ")
    );
    // Notes are lines of their own, however long.
    let mut tables = said.lines().filter(|line| !line.starts_with("NOTE "));
    assert!(tables.all(|line| line.chars().count() <= 100), "{said}");
    let explained = run(&["-v"]);
    assert!(
        explained.contains("osc: operational-space control.") && !explained.contains("`-v`"),
        "{explained}"
    );
    let ik = run(&["--controller", "ik"]);
    assert!(!ik.contains("elbow "), "a table without any torque: {ik}");
}

/// Compared: the codes of the problems that `run` and `check` list for the same files.
#[test]
fn run_lists_the_problems_of_check() {
    let folder = scratch();
    let cases: [(&str, &[&str]); 3] = [
        ("panda-out-of-reach", &[]),
        ("compliant-x", &["robot.interface.gears=\"elastic\"", "robot.interface.measured=[\"position\"]"]),
        (
            "panda-impedance",
            &["robot.interface.gears=\"elastic\"", "robot.simulated.true_over_nominal.kp=3.0"],
        ),
    ];
    let mut number = 0;
    for (name, settings) in cases {
        let task = task(name);
        let settings: Vec<&str> = settings.iter().flat_map(|setting| ["--set", *setting]).collect();
        let check = opspace(folder.path(), &[&["check", &task, "--json", "-"], &settings[..]].concat());
        let mut checked: Vec<String> = check.json()["files"][0]["findings"]
            .as_array()
            .unwrap()
            .iter()
            .map(|finding| finding["code"].as_str().unwrap().to_owned())
            .collect();
        let run = ["run", &task, "--force", "--out", "out"];
        let said = opspace(folder.path(), &[&run, &settings[..]].concat()).stderr;
        let code = |line: &str| Some(line.strip_prefix("note: [")?.split_once(']')?.0.to_owned());
        let mut listed: Vec<String> = said.lines().filter_map(code).collect();
        checked.sort();
        listed.sort();
        assert_eq!(listed, checked, "{name}: {said}");
        number += listed.len();
    }
    assert!(number > 2, "problems were compared");
}

/// A reader that closes its pipe: the program ends without a message, and the results are complete on disk.
#[test]
fn closed_pipe_ends_quietly() {
    let folder = scratch();
    let task = task("compliant-x");
    let cases: [&[&str]; 6] = [
        &["run", &task, "--duration-s", "2", "-q"],
        &["schema", "task"],
        &["model", ROOT_ROBOT],
        &["check", ROOT_ROBOT],
        &["completion", "bash"],
        &["--help"],
    ];
    for arguments in cases {
        let mut child =
            command(folder.path(), arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), said.as_ref()), (Some(0), ""), "{arguments:?}");
    }
    assert!(folder.path().join("runs/compliant-x-asimo-arm-position/summary.json").exists());
}

const ROOT_ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/asimo-arm");

/// Starts a run that is too long to end by itself, and returns it when its log contains several seconds.
fn long_run(folder: &Path) -> (Child, PathBuf) {
    let task = task("compliant-x");
    let mut run = command(folder, &["run", &task, "--duration-s", "2000", "--out", "out"]);
    let child = run.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let log = folder.join("out/run.mcap");
    while fs::metadata(&log).map_or(0, |file| file.len()) < 4 << 20 {
        sleep(Duration::from_millis(20));
    }
    (child, log)
}

#[cfg(unix)]
#[test]
fn interrupt_stops_run_and_closes_log() {
    let folder = scratch();
    let (child, log) = long_run(folder.path());
    let interrupt = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(interrupt.success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("interrupted at") && said.contains("log is closed"), "{said}");
    assert!(Recording::read(&log).unwrap().damage.is_none());
    let summary = read_json(log.with_file_name("summary.json"));
    assert_eq!((&summary["interrupted"], &summary["faulted"]), (&Value::Bool(true), &Value::Null));
    opspace(folder.path(), &["replay", "out"]).exits(0);
    opspace(folder.path(), &["report", "out"]).exits(0);
}

/// A process killed during the run: the file contains the beginning of the run, with equal bits.
#[test]
fn killed_run_leaves_readable_log() {
    let folder = scratch();
    let (mut child, log) = long_run(folder.path());
    child.kill().unwrap();
    child.wait().unwrap();
    let cut = Recording::read(&log).unwrap();
    assert!(cut.damage.is_some());
    let tick = cut.channel("tick").unwrap();
    assert!(tick.len() > 1000);
    let replayed = opspace(folder.path(), &["replay", "out"]).exits(3).says(&["damaged"]);
    assert!(replayed.stdout.contains("are equal, bit for bit"), "{}", replayed.stdout);
    opspace(folder.path(), &["report", "out"]).exits(3).says(&["damaged"]);
    assert!(log.with_file_name("report.html").exists());

    let whole = Recording::read(run(folder.path(), "whole", "compliant-x", &[])).unwrap();
    let whole = whole.channel("tick").unwrap();
    let (a, b) = (tick.signal("q").unwrap(), whole.signal("q").unwrap());
    assert!((0..1000).all(|k| a.row(k) == b.row(k)), "the same run, cut short");
}

/// A run with a fault: the program exits with 1 and prints the cause, and the log is complete.
#[test]
fn fault_exits_with_1_and_its_cause() {
    let folder = scratch();
    let rms = "environment.operator.spring.motion.random.rms_m=2.0";
    let stiffness = "environment.operator.spring.stiffness_n_per_m=3000";
    let arguments = ["run", &task("compliant-x"), "--set", rms, "--set", stiffness, "--json", "-"];
    let ran = opspace(folder.path(), &arguments).exits(1);
    let summary = ran.json();
    let cause = summary["faulted"].as_str().unwrap();
    assert!(cause.contains("joint"), "{cause}");
    ran.says(&["stopped at", cause]);
    let shown =
        opspace(folder.path(), &["run", &task("compliant-x"), "--set", rms, "--set", stiffness]).exits(1);
    let first = shown.stdout.lines().next().unwrap();
    assert!(first.starts_with("STOPPED at ") && first.contains("until the stop"), "{first}");
    assert!(cause.split(' ').all(|word| word.trim_end_matches(',').len() < 18), "many digits: {cause}");
    let time = summary["fault_time_s"].as_f64().unwrap();
    let log = Recording::read(folder.path().join("runs/compliant-x-asimo-arm-position/run.mcap")).unwrap();
    assert!(log.damage.is_none());
    assert!(*log.channel("tick").unwrap().time_s.last().unwrap() >= time, "the last ticks are in the log");
}

const SUITE: &str = r#"
title = "short"
[[run]]
tasks = ["TASKS/gravity-compensation.toml", "TASKS/compliant-x.toml"]
backend = "torque"
controller = "osc"
profiles = ["a-med", "b-soft"]
override = ["duration_s=1.6"]
[[run]]
tasks = ["TASKS/cartesian-tracking.toml", "TASKS/joint-tracking.toml", "TASKS/compliant-x.toml"]
backend = "position"
controller = "ik-lead"
seeds = [1, 2]
override = ["duration_s=1.6"]
[[run]]
tasks = ["TASKS/compliant-x.toml"]
backend = "position"
controller = "osc"
override = ["duration_s=1.6"]
"#;

#[test]
fn suite_table_is_independent_of_job_count() {
    let folder = scratch();
    fs::write(folder.path().join("short.toml"), SUITE.replace("TASKS", &project("tasks"))).unwrap();
    let ran = opspace(folder.path(), &["bench", "short.toml", "--json", "rows.json", "--jobs", "2"]).exits(0);
    let longest = ran.stdout.lines().map(|line| line.chars().count()).max().unwrap();
    assert!(longest <= 100, "{longest} columns:\n{}", ran.stdout);
    let titles: Vec<&str> = ran.stdout.lines().filter(|line| line.ends_with("-x")).collect();
    let blocks = ran.stdout.lines().filter(|line| line.starts_with("─")).count();
    assert_eq!(titles, vec![" compliant-x"; blocks], "a task's rows stand together");
    let json = read_json(folder.path().join("rows.json"));
    assert_eq!(json["schema"], "opspace.bench/1");
    assert_eq!(json, read_json(folder.path().join("runs/bench-short/bench.json")));
    let rows = |json: &Value| {
        let mut rows = json["rows"].as_array().unwrap().clone();
        rows.iter().for_each(assert_row);
        rows.iter_mut().for_each(|row| row["timing"] = Value::Null);
        rows
    };
    assert_eq!(rows(&json).len(), 4 + 6 + 1);
    let alone = opspace(folder.path(), &["bench", "short.toml", "--json", "-", "--jobs", "1"]).exits(0);
    assert_eq!(rows(&alone.json()), rows(&json));
    alone.says(&["runs/bench-short.previous"]);
    let replayed = ["replay", "runs/bench-short/compliant-x-torque.mcap"];
    opspace(folder.path(), &replayed).exits(0);
}

#[test]
fn suite_with_fault_exits_with_1_and_all_rows() {
    let folder = scratch();
    let faulty = format!(
        "{SUITE}\n[[run]]\ntasks = [\"TASKS/compliant-x.toml\"]\nbackend = \"position\"\ncontroller = \"osc\"\n\
         override = [\"environment.operator.spring.motion.random.rms_m=2.0\",\n\
         \"environment.operator.spring.stiffness_n_per_m=3000\"]\n"
    );
    fs::write(folder.path().join("short.toml"), faulty.replace("TASKS", &project("tasks"))).unwrap();
    let ran = opspace(folder.path(), &["bench", "short.toml"]).exits(1);
    assert!(ran.stdout.contains("1 faulted"), "{}", ran.stdout);
    let rows = read_json(folder.path().join("runs/bench-short/bench.json"));
    assert_eq!(rows["rows"].as_array().unwrap().len(), 12);
}

#[test]
fn report_accepts_logs_and_folders() {
    let folder = scratch();
    run(folder.path(), "a", "compliant-x", &[]);
    let log = run(folder.path(), "b", "compliant-x", &["--backend", "torque"]);
    let arguments = ["report", "a", log.to_str().unwrap(), "-o", "both.html", "--json", "both.json"];
    let said = opspace(folder.path(), &arguments).exits(0).stdout;
    assert_eq!(said, "both.html\n");
    let page = read(folder.path().join("both.html"));
    assert!(page.contains("position robot") && page.contains("torque robot"));
    // The results from the log equal those printed after the run, except for values that depend on the clock.
    let rows = read_json(folder.path().join("both.json"));
    for (row, name) in rows.as_array().unwrap().iter().zip(["a", "b"]) {
        let summary = read_json(folder.path().join(name).join("summary.json"));
        assert_eq!(row["metrics"], summary["metrics"], "{name}");
        assert_eq!(row["timing"]["tick_ns_median"], summary["timing"]["tick_ns_median"]);
    }
    opspace(folder.path(), &["report", "a", "-o", "none/x.html"]).exits(2).says(&["none/x.html"]);
}

#[test]
fn robot_is_printed_as_table_or_json() {
    let folder = scratch();
    let table = opspace(folder.path(), &["model", ROOT_ROBOT]).exits(0).stdout;
    let toml = format!("{ROOT_ROBOT}/robot.toml");
    assert_eq!(opspace(folder.path(), &["model", &toml]).exits(0).stdout, table);
    assert!(table.contains("4 moving joints") && table.contains("revolute (rad, Nm)"), "{table}");
    let json = opspace(folder.path(), &["model", &toml, "--json", "-"]).exits(0).json();
    let names = |key: &str| -> Vec<String> {
        let all = json[key].as_array().unwrap().iter();
        all.map(|one| one["name"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(names("joints"), ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"]);
    for name in names("joints").iter().chain(&names("frames")) {
        assert!(table.contains(name), "{name}");
    }
    // The URDF alone contains no rotor inertias.
    let urdf = opspace(folder.path(), &["model", &format!("{ROOT_ROBOT}/asimo-arm.urdf"), "--json", "-"]);
    assert_eq!(urdf.exits(0).json()["joints"][0]["rotor_inertia"], 0.0);
    assert!((json["joints"][0]["rotor_inertia"].as_f64().unwrap() - 120.0 * 120.0 * 1.6e-5).abs() < 1e-12);
    // The torque limits of robot.toml count, not those of the URDF.
    let text = std::fs::read_to_string(ROOT_ROBOT.to_owned() + "/robot.toml").unwrap();
    std::fs::write(
        folder.path().join("robot.toml"),
        text.replace("torque_limit_nm = 40.0", "torque_limit_nm = 33.0"),
    )
    .unwrap();
    let urdf_file = "asimo-arm.urdf";
    std::fs::copy(format!("{ROOT_ROBOT}/{urdf_file}"), folder.path().join(urdf_file)).unwrap();
    let json = opspace(folder.path(), &["model", "robot.toml", "--json", "-"]).exits(0).json();
    assert_eq!(json["joints"][0]["effort"], 33.0);
}

fn numbers(list: &Value) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// Compared: masses, centres of mass and offsets, and the text of the file.
#[test]
fn robot_table_matches_its_file() {
    let folder = scratch();
    let urdf = project("tests/oracles/pinocchio/urdf/panda_arm7.urdf");
    let shown = opspace(folder.path(), &["model", &urdf, "--json", "-"]).exits(0).json();
    let text = read(&urdf);
    let masses = text.split("<mass value=\"").skip(1).map(|rest| rest.split('"').next().unwrap());
    let sum: f64 = masses.map(|mass| mass.parse::<f64>().unwrap()).sum();
    let total = shown["total_mass_kg"].as_f64().unwrap();
    assert!(
        (total - sum).abs() < 1e-9 && shown["moving_mass_kg"].as_f64().unwrap() < total,
        "{total}, {sum}"
    );
    let table = opspace(folder.path(), &["model", &urdf]).exits(0);
    assert!(table.stdout.contains("7 moving joints on a fixed base, 16.822 kg moving, 17.452 kg in total"));
    assert_eq!(table.stderr, "", "nothing is wrong with it");
    // A robot whose axes are not along z: offsets are given in link axes and not in model axes.
    let urdf = project("tests/oracles/pinocchio/urdf/ur5.urdf");
    let shown = opspace(folder.path(), &["model", &urdf, "--json", "-"]).exits(0).json();
    let text = read(&urdf);
    let origin = |of: &str| {
        let after = text.split_once(of).unwrap().1.split_once("xyz=\"").unwrap().1;
        let numbers = after.split('"').next().unwrap().split_whitespace();
        numbers.map(|x| x.parse().unwrap()).collect::<Vec<f64>>()
    };
    let assert_near = |said: &Value, place: &str| {
        let (said, written) = (numbers(said), origin(place));
        assert!(said.iter().zip(&written).all(|(a, b)| (a - b).abs() < 1e-9), "{said:?}, {written:?}");
        assert!(written.iter().any(|x| *x != 0.0), "{place}");
    };
    let (upper_arm, joint) = (&shown["bodies"][1], &shown["joints"][1]);
    assert_eq!((&upper_arm["link"], &upper_arm["joint"]), (&"upper_arm_link".into(), &joint["name"]));
    assert_near(&upper_arm["com_m"], "<inertial>\n      <mass value=\"8.393\"");
    assert_eq!(joint["carried_by"], "shoulder_link");
    let tool = shown["frames"].as_array().unwrap().iter().find(|f| f["name"] == "ee_link").unwrap();
    assert_eq!((&tool["fixed_to"], &tool["moves_with"]), (&"wrist_3_link".into(), &"wrist_3_joint".into()));
    assert_near(&tool["offset_m"], "<joint name=\"ee_fixed_joint\"");
}

/// Warnings of the URDF parser and about the whole model: on stderr with the file name, and as JSON.
#[test]
fn robot_warnings_are_printed() {
    let folder = scratch();
    for (name, count, words) in [
        ("ur5", 3, &["link 'wrist_1_link'", "a solid of 8.35 kg/m³"][..]),
        ("allegro_right_hand", 4, &["line 143: link 'link_3.0'", "triangle inequality"]),
        ("xarm7_turned", 0, &[]),
    ] {
        let urdf = project(&format!("tests/oracles/pinocchio/urdf/{name}.urdf"));
        let ran = opspace(folder.path(), &["model", &urdf, "--json", "-"]).exits(0);
        let warnings = ran.json()["warnings"].clone();
        let said: Vec<String> =
            warnings.as_array().unwrap().iter().map(|w| format!("{urdf}: {}", w.as_str().unwrap())).collect();
        assert_eq!(said.len(), count, "{name}: {said:?}");
        assert_eq!(ran.stderr.lines().collect::<Vec<_>>(), said, "{name}");
        ran.says(words);
    }
    for robot in ["asimo-arm", "panda", "planar-2-link", "ur5e"] {
        let ran = opspace(folder.path(), &["model", &project(&format!("robots/{robot}"))]).exits(0);
        assert_eq!(ran.stderr, "", "{robot}");
    }
}

#[test]
fn urdf_can_float_and_enforce_mimic_joints() {
    let folder = scratch();
    let urdf = project("tests/oracles/pinocchio/urdf/panda.urdf");
    let shown = |options: &[&str]| {
        let arguments = [&["model", &urdf, "--json", "-"], options].concat();
        opspace(folder.path(), &arguments).exits(0)
    };
    let count = |value: &Value, key: &str| value[key].as_array().unwrap().len();
    let fixed = shown(&[]);
    fixed.json()["warnings"][0].as_str().unwrap().find("mimics").expect("it is said");
    let fixed = fixed.json();
    assert_eq!((count(&fixed, "joints"), count(&fixed, "bodies"), &fixed["base"]), (9, 9, &"fixed".into()));
    let folded = shown(&["--enforce-mimic"]).json();
    assert_eq!((count(&folded, "joints"), count(&folded, "bodies"), count(&folded, "warnings")), (8, 9, 0));
    // Both fingers move with the remaining joint.
    let fingers = 2.0 * fixed["joints"][8]["mass_kg"].as_f64().unwrap();
    assert!((folded["joints"][7]["mass_kg"].as_f64().unwrap() - fingers).abs() < 1e-12);
    let floating = shown(&["--floating"]).json();
    assert_eq!((count(&floating, "joints"), count(&floating, "bodies")), (15, 10));
    assert_eq!(
        (&floating["base"], &floating["bodies"][0]["link"]),
        (&"floating".into(), &"panda_link0".into())
    );
    assert_eq!(floating["moving_mass_kg"], floating["total_mass_kg"]);
    let table = opspace(folder.path(), &["model", &urdf, "--floating", "--enforce-mimic"]).exits(0).stdout;
    assert!(table.contains("8 moving joints on a floating base, 17.452 kg moving, 17.452 kg in total"));
    assert!(table.contains("base.angular.z") && table.contains("the base (floating)"), "{table}");
    // A state then begins with position and quaternion of the base. With them the command succeeds; without them the
    // error gives the required number.
    let sample = |nq: usize| {
        let list = |length: usize, at: usize| -> Vec<f64> {
            (0..length).map(|i| if i == at { 1.0 } else { 0.0 }).collect()
        };
        let line = serde_json::json!({
            "q": list(nq, 6), "dq": list(15, 99), "ddq": list(15, 99), "tau_in": list(15, 99), "f_tip": list(6, 99),
        });
        let path = folder.path().join("samples.jsonl");
        fs::write(&path, line.to_string()).unwrap();
        opspace(
            folder.path(),
            &["model", &urdf, "--floating", "--tip", "panda_hand", "--samples", "samples.jsonl"],
        )
    };
    let quantities = sample(16).exits(0).json();
    // The floating robot has its full weight: the third component of gravity is m g.
    let weight = quantities["g"][2].as_f64().unwrap();
    assert!((weight - 9.81 * floating["total_mass_kg"].as_f64().unwrap()).abs() < 1e-9, "{weight}");
    sample(15).exits(2).says(&["16"]);
    // These options are only for a URDF and not for a robot folder.
    for option in ["--floating", "--enforce-mimic"] {
        let refused = opspace(folder.path(), &["model", ROOT_ROBOT, option]).exits(2);
        refused.says(&[option, "asimo-arm.urdf"]);
    }
}

const SCHEMAS: [(&str, &str); 4] = [
    ("robot", "robots/robot.schema.json"),
    ("task", "tasks/task.schema.json"),
    ("suite", "tasks/suite.schema.json"),
    ("experiment", "tasks/experiments/experiment.schema.json"),
];

/// Compared: the committed schemas, which editors use, and the current output of the program. `OPSPACE_WRITE_DOCS=1` writes them.
#[test]
fn committed_schemas_match_the_program() {
    let folder = scratch();
    for (kind, path) in SCHEMAS {
        let schema = opspace(folder.path(), &["schema", kind]).exits(0);
        if std::env::var_os("OPSPACE_WRITE_DOCS").is_some() {
            fs::write(project(path), &schema.stdout).unwrap();
        }
        assert!(
            schema.stdout == read(project(path)),
            "{path} is out of date: OPSPACE_WRITE_DOCS=1 writes it"
        );
        assert_eq!(schema.json()["additionalProperties"], false, "{kind}");
    }
    opspace(folder.path(), &["schema", "robots"]).exits(2).says(&["robot"]);
}

#[test]
fn every_shell_has_a_completion() {
    let folder = scratch();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = opspace(folder.path(), &["completion", shell]).exits(0).stdout;
        assert!(COMMANDS.iter().all(|name| script.contains(name)), "{shell}");
    }
    opspace(folder.path(), &["completion", "csh"]).exits(2).says(&["bash"]);
}

/// Creates a folder with the ASIMO-like arm, without its robot.toml, and a task of it.
fn arm_folder() -> tempfile::TempDir {
    let folder = scratch();
    for name in ["robots/asimo-arm", "tasks"] {
        fs::create_dir_all(folder.path().join(name)).unwrap();
    }
    for file in ["robots/asimo-arm/asimo-arm.urdf", "tasks/gravity-compensation.toml"] {
        fs::copy(project(file), folder.path().join(file)).unwrap();
    }
    folder
}

/// The reported gain margin of a task is that for the command interface declared in the robot file.
#[test]
fn check_uses_robot_kind_of_the_file() {
    let folder = arm_folder();
    let robot = folder.path().join("robots/asimo-arm");
    let text = read(project("robots/asimo-arm/robot.toml"));
    // The behaviour at a missed cycle must match the command interface.
    let text: String =
        text.split_inclusive('\n').filter(|line| !line.starts_with("on_missed_cycle")).collect();
    for (command, margin) in
        [("position", "position_gain_margin"), ("velocity", "velocity_gain_margin"), ("torque", "none")]
    {
        let stated = "command = \"position\"";
        assert!(text.contains(stated));
        fs::write(robot.join("robot.toml"), text.replace(stated, &format!("command = \"{command}\"")))
            .unwrap();
        let arguments = ["check", "tasks/gravity-compensation.toml", "--json", "-"];
        let json = opspace(folder.path(), &arguments).exits(0).json();
        let file = &json["files"][0];
        for key in ["position_gain_margin", "velocity_gain_margin"] {
            assert_eq!(file[key].is_object(), key == margin, "{command}: {key} in {file}");
        }
    }
}

/// A real robot whose gears may be elastic is not run with the emulation, unless this is asked for; a simulated one is.
#[test]
fn run_refuses_real_robot_with_small_margins() {
    let folder = arm_folder();
    let robot = folder.path().join("robots/asimo-arm");
    let text =
        read(project("robots/asimo-arm/robot.toml")).replace("gears = \"rigid\"", "gears = \"elastic\"");
    fs::write(robot.join("robot.toml"), text + "\n[driver]\nname = \"absent\"\n").unwrap();
    let run = ["run", "tasks/gravity-compensation.toml", "--transformer", "emulation+current"];
    opspace(folder.path(), &run).exits(2).says(&[
        "on elastic gears oscillates at antiresonances of 20 Hz",
        "use 'extrapolation+current'",
        "[gear-oscillation]",
        "--allow gear-oscillation runs it nevertheless",
    ]);
    let other = [run.as_slice(), &["--allow", "small-gain-margin"]].concat();
    opspace(folder.path(), &other).exits(2).says(&["[gear-oscillation]"]);
    let accepted = [run.as_slice(), &["--allow", "gear-oscillation"]].concat();
    opspace(folder.path(), &accepted).exits(2).says(&[
        "[gear-oscillation, allowed]",
        "no driver",
        "[missing-driver]",
    ]);
    let default = &run[..2];
    opspace(folder.path(), default).exits(2).says(&["no driver"]);
    let simulated = [run.as_slice(), &["--simulate", "--duration-s", "1.6"]].concat();
    opspace(folder.path(), &simulated).exits(0);

    // The margins are printed with `-v`, and are no findings for the default transformer.
    let check = ["check", "tasks/gravity-compensation.toml", "--simulate"];
    let short = opspace(folder.path(), &check).exits(0);
    assert!(
        short.stdout.lines().count() < 10 && !short.stdout.contains("gain of position loops"),
        "{}",
        short.stdout
    );
    assert!(short.stdout.contains("`-v` prints them\n"), "{}", short.stdout);
    assert_eq!(short.stderr, "");
    let checked = opspace(folder.path(), &[&check[..], &["-v"]].concat()).exits(0);
    let (table, title) =
        (&checked.stdout, "with transformer 'extrapolation+current':\n    gain of position loops");
    assert!(table.contains(title), "{table}");
    assert!(table.contains("error, Nm  of limit\n    shoulder_pitch "), "{table}");
    let is_wide = |line: &&str| line.starts_with("    ") && line.chars().count() > 100;
    assert_eq!(table.lines().find(is_wide), None);
    for text in [&short.stdout, table] {
        assert!(!text.lines().any(|line| line.ends_with(']') && line.contains(" [")), "{text}");
    }
    opspace(folder.path(), &check[..2]).exits(2).says(&["no driver", "[missing-driver]"]);
}

#[test]
fn check_recognises_file_kinds() {
    let folder = scratch();
    let at = |path: &str| opspace(Path::new(ROOT), &["check", path]).exits(0).stdout;
    assert_eq!(at("robots/asimo-arm"), "robots/asimo-arm: a robot of 4 joints\n");
    assert_eq!(at("robots/asimo-arm/robot.toml"), "robots/asimo-arm/robot.toml: a robot of 4 joints\n");
    let urdf = "robots/asimo-arm/asimo-arm.urdf";
    assert_eq!(at(urdf), format!("{urdf}: a URDF of 4 moving joints\n"));
    let task = at("tasks/compliant-x.toml");
    assert!(
        task.starts_with(
            "tasks/compliant-x.toml: a task for the robot 'asimo-arm'\n  position loops tolerate "
        )
    );
    assert!(at("tasks/suites/paper.toml").contains(": a suite of "));

    // Several files: each is reported, and one mistake is enough for the exit code.
    fs::write(folder.path().join("bad.toml"), "robot = \".\"\nduration_s = 1.0\n").unwrap();
    fs::write(folder.path().join("other.toml"), "[package]\nname = \"x\"\n").unwrap();
    let arguments = ["check", ROOT_ROBOT, "bad.toml", "other.toml", "none.toml", "--json", "-"];
    let ran = opspace(folder.path(), &arguments).exits(2);
    let json = ran.json();
    let files = json["files"].as_array().unwrap();
    let ok: Vec<Option<bool>> = files.iter().map(|file| file["ok"].as_bool()).collect();
    assert_eq!(ok, [Some(true), Some(false), Some(false), Some(false)]);
    ran.says(&[
        "bad.toml: missing key `priority`",
        "other.toml: is neither a robot file nor a task file nor a suite file",
        "none.toml: there is no such file",
    ]);
    let empty = scratch();
    opspace(empty.path(), &["check", "."]).exits(2).says(&["robot.toml: there is no such file"]);
}

/// `--set` changes the task and the robot that are checked, as it does for a run. A file without problems says so.
#[test]
fn check_takes_settings() {
    let check = |file: &str, setting: &str| opspace(Path::new(ROOT), &["check", file, "--set", setting]);
    let task = "tasks/compliant-x.toml";
    let good = check(task, "task.hand.cartesian.gains.frequency_rad_per_s=10").exits(0);
    assert!(good.stdout.contains("\n  no problems found\n"), "{}", good.stdout);
    let stiff = check(task, "task.hand.cartesian.gains.frequency_rad_per_s=2000").exits(0);
    stiff.prints(&["would be unstable", "--set task.hand.cartesian.gains.frequency_rad_per_s=2000"]);
    let weak = "robot.joint.shoulder_pitch.torque_limit_nm=0.5";
    check(task, weak).exits(0).prints(&["--set robot.joint.shoulder_pitch.torque_limit_nm=0.5"]);
    let experiment = "tasks/experiments/teleop-free.toml";
    check(experiment, "duration_s=-1.0").exits(2).says(&["duration_s"]);
    for file in [ROOT_ROBOT, "tasks/suites/paper.toml", "robots/asimo-arm/asimo-arm.urdf"] {
        check(file, "seed=1").exits(2).says(&["has no values for --set"]);
    }
}

/// `--controller` and `--backend` change the robot that is checked, as they do for a run; files that state their own refuse them.
#[test]
fn check_takes_controller_and_backend() {
    let check =
        |file: &str, options: &[&str]| opspace(Path::new(ROOT), &[&["check", file], options].concat());
    let task = "tasks/compliant-x.toml";
    let ignored = "[ignored-compliance]";
    assert!(!check(task, &[]).exits(0).stdout.contains(ignored));
    check(task, &["--controller", "ik"]).exits(0).prints(&[ignored]);
    let margin = |options: &[&str]| {
        let file = &check(task, &[&["--json", "-"], options].concat()).exits(0).json()["files"][0];
        file["position_gain_margin"].is_object()
    };
    assert!(margin(&[]) && !margin(&["--backend", "torque"]));
    check(task, &["--controller", "pid"]).exits(2).says(&["ik-lead"]);
    for file in [ROOT_ROBOT, "tasks/suites/paper.toml", "tasks/experiments/teleop-free.toml"] {
        for options in [["--controller", "ik"], ["--backend", "torque"]] {
            check(file, &options).exits(2).says(&["has no use for --", "for task files"]);
        }
    }
}

/// With `--strict` the exit code tells whether a problem was found: 1 with one, 0 without, and 2 if a file is invalid.
#[test]
fn strict_check_fails_if_it_finds_a_problem() {
    let check = |files: &[&str]| opspace(Path::new(ROOT), &[&["check", "--strict"], files].concat());
    let (good, bad) = ("tasks/compliant-x.toml", "tasks/ur5e-out-of-reach.toml");
    check(&[good]).exits(0);
    let ran = check(&[bad, good]).exits(1).prints(&["[goal-out-of-reach]"]);
    assert_eq!(ran.stderr, "");
    // The problem is below the line of its file, and above that of the next one.
    let at = |text: &str| ran.stdout.find(text).unwrap();
    let next = format!("\n{good}: a task");
    assert!(at(&format!("{bad}: a task")) < at("[goal-out-of-reach]"), "{}", ran.stdout);
    assert!(at("[goal-out-of-reach]") < at(&next), "{}", ran.stdout);
    check(&[bad, "tasks/none.toml"]).exits(2);
    opspace(Path::new(ROOT), &["check", bad]).exits(0);
}

/// Before a run, its stderr has the problems that `check` finds, in a line each; not if it is quiet, and not without any.
#[test]
fn run_names_problems_before_it() {
    let folder = scratch();
    let run = |controller: &str, options: &[&str]| {
        let task = project("tasks/compliant-x.toml");
        let run =
            ["run", &task, "--duration-s", "1.6", "--force", "--out", "out", "--controller", controller];
        opspace(folder.path(), &[&run, options].concat()).exits(0).stderr
    };
    let said = run("ik", &[]);
    assert!(said.starts_with("note: [ignored-compliance] ") && said.contains("compliance along x"), "{said}");
    let explained = format!(
        "note: `opspace check {}` with the same options explains this problem\n",
        task("compliant-x")
    );
    assert!(said.contains(&explained), "{said}");
    assert!(!run("osc", &[]).contains("note: "));
    assert!(!run("ik", &["--quiet"]).contains("note: "));
}

#[test]
fn file_of_wrong_kind_is_refused() {
    let folder = scratch();
    let task = task("compliant-x");
    let robot = format!("{ROOT_ROBOT}/robot.toml");
    opspace(folder.path(), &["run", &robot])
        .exits(2)
        .says(&["is a robot file; a task file is expected here"]);
    opspace(folder.path(), &["bench", &task])
        .exits(2)
        .says(&["is a task file; a suite file is expected here"]);
    let swapped = ["run", &task, "--robot", &task];
    opspace(folder.path(), &swapped).exits(2).says(&["is a task file; a robot file is expected here"]);
}

/// A file is written only if all states are valid; the file with the samples is never overwritten.
#[test]
fn invalid_samples_write_no_file() {
    let folder = scratch();
    let urdf = project("robots/planar-2-link/planar-2-link.urdf");
    let line = r#"{"q":[0.1,0.2],"dq":[0,0],"ddq":[0,0],"tau_in":[0,0],"f_tip":[0,0,0,0,0,0]}"#;
    let path = |name: &str| folder.path().join(name);
    fs::write(path("states.jsonl"), line).unwrap();
    fs::write(path("kept.jsonl"), "kept").unwrap();
    let run = |tip: &str, samples: &str, json: &str| {
        opspace(folder.path(), &["model", &urdf, "--tip", tip, "--samples", samples, "--json", json])
    };
    run("tipp", "states.jsonl", "kept.jsonl").exits(2);
    run("tip", "nothing.jsonl", "kept.jsonl").exits(2);
    assert_eq!(read(path("kept.jsonl")), "kept");
    let same = run("tip", "states.jsonl", "./states.jsonl").exits(2);
    assert!(same.stderr.contains("is an input of this command"), "{}", same.stderr);
    assert_eq!(read(path("states.jsonl")), line);
    run("tip", "states.jsonl", "new.jsonl").exits(0);
    assert!(read(path("new.jsonl")).contains("tau_rnea"));
}

/// Table of a robot without moving joints.
#[test]
fn robot_without_joints_has_a_table() {
    let folder = scratch();
    fs::write(folder.path().join("table.urdf"), r#"<robot name="t"><link name="table"/></robot>"#).unwrap();
    let ran = opspace(folder.path(), &["model", "table.urdf"]).exits(0);
    assert!(ran.stdout.contains("0 moving joints on a fixed base"), "{}", ran.stdout);
}

/// Output for a task with an impedance, whose gains depend on the inertia of the arm.
#[test]
fn check_lists_unchecked_tasks() {
    let arguments = ["check", "tasks/panda-impedance.toml"];
    let said = opspace(Path::new(ROOT), &arguments).exits(0).stdout;
    assert!(said.contains("not checked: tasks/panda-impedance.toml"), "{said}");
    assert!(said.contains("of 400 sampled postures within position limits"), "{said}");
    let json = opspace(Path::new(ROOT), &[&arguments[..], &["--json", "-"]].concat()).exits(0).json();
    assert_eq!(json["files"][0]["singular_postures"][0]["sampled"], 400, "{json}");
    let skipped = json["files"][0]["not_checked"].as_array().unwrap();
    assert!(skipped.iter().all(|one| one["code"] == "unknown-gains") && !skipped.is_empty(), "{json}");
    let help = skipped[0]["help"].as_str().unwrap();
    assert!(help.contains("run it in simulation"), "{help}");
}

/// Compared: the command interface in the summary, and the one declared in robot.toml or requested by an option.
#[test]
fn run_uses_robot_kind_of_robot_toml() {
    let folder = scratch();
    let task = project("tasks/gravity-compensation.toml");
    let command = "robot.interface.command=velocity";
    for (asked, backend) in [(&[][..], "velocity"), (&["--backend", "torque"][..], "torque")] {
        let set = ["--set", command, "--set", "robot.interface.on_missed_cycle=hold-last"];
        let fixed =
            ["run", &task, "--duration-s", "0.2", "--set", "settle_s=0", "--out", backend, "--json", "-"];
        let ran = opspace(folder.path(), &[&fixed[..], &set, asked].concat()).exits(0);
        assert_eq!(ran.json()["backend"], backend);
        assert_eq!(ran.json()["simulated"], true);
    }
}

/// Compared: the start that `run` and `check` print, and the start of the task file; the hand is where the log begins.
#[test]
fn start_is_printed_before_a_run() {
    let folder = scratch();
    let task = project("tasks/press-wall.toml");
    let ran = opspace(folder.path(), &["run", &task, "--duration-s", "2.1", "--out", "out"]).exits(0);
    let start =
        "starts at shoulder_pitch -0.45 rad, shoulder_roll -0.35 rad, shoulder_yaw 0.25 rad, elbow -1.35 rad";
    let line =
        ran.stderr.lines().find(|line| line.contains(start)).unwrap_or_else(|| panic!("{}", ran.stderr));
    let at = line.split_once("'hand' is at (").unwrap().1.split_once(") m").unwrap().0;
    let printed: Vec<f64> = at.split(", ").map(|value| value.parse().unwrap()).collect();
    let recording = opspace_log::Recording::read(folder.path().join("out/run.mcap")).unwrap();
    let tick = recording.channel("tick").unwrap();
    // The reference begins where the hand is at the first cycle of control.
    let first = tick.signal("phase").unwrap().rows().position(|phase| phase[0] == 1.0).unwrap();
    let begin = tick.signal("hand.reference").unwrap().row(first);
    // Three digits are printed.
    assert!(printed.iter().zip(begin).all(|(a, b)| (a - b).abs() < 1e-3), "{printed:?}, {begin:?}");
    opspace(folder.path(), &["check", &task, "-v"]).exits(0).says(&[start]);
}

/// Checks that `check` takes a transformer, as `run` does, and that files without one refuse it.
#[test]
fn check_takes_a_transformer() {
    let folder = scratch();
    let task = project("tasks/gravity-compensation.toml");
    let arguments = ["check", task.as_str(), "--transformer", "extrapolation"];
    let checked = opspace(folder.path(), &arguments).exits(0);
    assert!(checked.stdout.contains("with transformer 'extrapolation'"), "{}", checked.stdout);
    let robot = project("robots/asimo-arm");
    opspace(folder.path(), &["check", robot.as_str(), "--transformer", "paper"])
        .exits(2)
        .says(&["has no use for --transformer"]);
}

/// `check` examines a task with another robot, as `run` runs it.
#[test]
fn check_takes_a_robot() {
    let folder = scratch();
    let task = project("tasks/gravity-compensation.toml");
    let panda = project("robots/panda");
    opspace(folder.path(), &["check", task.as_str(), "--robot", panda.as_str()])
        .exits(2)
        .says(&["this robot has no joint"]);
    let asimo = project("robots/asimo-arm");
    let checked = opspace(folder.path(), &["check", task.as_str(), "--robot", asimo.as_str()]).exits(0);
    assert!(checked.stdout.contains("a task for the robot"), "{}", checked.stdout);
    opspace(folder.path(), &["check", asimo.as_str(), "--robot", panda.as_str()])
        .exits(2)
        .says(&["has no use for --robot"]);
}
