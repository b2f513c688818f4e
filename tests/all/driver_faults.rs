//! Faults of drivers and devices, and signals, in the complete program with a driver: a robot is never left on its last command
//! if its driver can be called, and log, summary and exit code say what happened.
#![cfg(unix)]
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

mod faulty_driver;

use crate::cli_common::{opspace, project, read, read_json, scratch};
use faulty_driver::FaultyDriver;
use opspace_cli::{Extensions, main_with_args};
use opspace_log::Recording;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Arguments of the program in a child process, one a line.
const ARGUMENTS: &str = "OPSPACE_TEST_ARGUMENTS";
/// Longest time that the program takes to end, s; on a loaded computer.
const LONGEST_S: f64 = 15.0;

/// The program with the driver: a process that the tests below start from this file's own executable.
#[test]
#[ignore = "a program of the other tests"]
fn program() {
    let Ok(arguments) = std::env::var(ARGUMENTS) else { return };
    let exit = main_with_args(Extensions::default().with_driver(FaultyDriver), arguments.lines());
    let code = (0..=u8::MAX).find(|code| ExitCode::from(*code) == exit).unwrap();
    std::process::exit(code.into());
}

/// A run of the arm in a folder.
struct Driven<'a> {
    folder: &'a Path,
    child: Child,
}

/// Rest of a run.
struct Ended {
    code: Option<i32>,
    said: String,
    calls: Vec<String>,
    summary: Option<Value>,
}

/// Starts a run whose driver has these keys.
fn start<'a>(folder: &'a Path, keys: &str, options: &[&str]) -> Driven<'a> {
    let robot = project("tests/own-driver/robot");
    let task = read(project("tests/own-driver/swing.toml"));
    let task = task.replace("robot = \"robot\"", &format!("robot = {robot:?}"));
    fs::write(folder.join("swing.toml"), task).unwrap();
    let calls = folder.join("calls");
    let driver = format!("robot.driver={{ name = \"faulty\", calls = {calls:?}, {keys} }}");
    let arguments = ["opspace", "run", "swing.toml", "--controller", "ik", "--out", "out", "--set", &driver];
    let child = Command::new(std::env::current_exe().unwrap())
        .args(["driver_faults::program", "--exact", "--ignored", "--nocapture"])
        .env(ARGUMENTS, [&arguments, options].concat().join("\n"))
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    Driven { folder, child }
}

impl Driven<'_> {
    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([name, &self.child.id().to_string()]).status().unwrap();
        assert!(sent.success());
    }

    /// Waits until the file of calls has a line, or the log some rows.
    fn wait_for(&self, condition: impl Fn(&Path) -> bool) {
        let began = Instant::now();
        while !condition(self.folder) {
            assert!(began.elapsed().as_secs_f64() < LONGEST_S, "it does not begin");
            sleep(Duration::from_millis(10));
        }
    }

    /// Waits for the end of the program.
    #[track_caller]
    fn end(mut self) -> Ended {
        let began = Instant::now();
        while self.child.try_wait().unwrap().is_none() {
            if began.elapsed().as_secs_f64() > LONGEST_S {
                self.child.kill().unwrap();
                panic!("it does not end");
            }
            sleep(Duration::from_millis(10));
        }
        let output = self.child.wait_with_output().unwrap();
        let calls = fs::read_to_string(self.folder.join("calls")).unwrap_or_default();
        let summary = self.folder.join("out/summary.json");
        Ended {
            code: output.status.code(),
            said: String::from_utf8_lossy(&output.stderr).into_owned(),
            calls: calls.lines().map(str::to_owned).collect(),
            summary: summary.exists().then(|| read_json(&summary)),
        }
    }
}

impl Ended {
    #[track_caller]
    fn exits(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{:?}\n{}", self.calls, self.said);
        self
    }

    #[track_caller]
    fn says(self, words: &[&str]) -> Self {
        for word in words {
            assert!(self.said.contains(word), "'{word}' isn't said:\n{}", self.said);
        }
        self
    }

    /// Checks how often the driver's stop was called, and that the robot was closed.
    #[track_caller]
    fn stops(self, least: usize, most: usize) -> Self {
        let stops = self.calls.iter().filter(|call| *call == "stop").count();
        assert!((least..=most).contains(&stops), "{:?}\n{}", self.calls, self.said);
        assert_eq!(self.calls.last().map(String::as_str), Some("closed"), "{:?}", self.calls);
        self
    }

    /// Checks the fault in the summary, and that the log is whole and replays equal.
    #[track_caller]
    fn logs(&self, folder: &Path, fault: Option<&str>) {
        let summary = self.summary.as_ref().unwrap_or_else(|| panic!("no summary:\n{}", self.said));
        match fault {
            None => assert_eq!(summary["faulted"], Value::Null),
            Some(words) => {
                let found = summary["faulted"].as_str().unwrap_or_default();
                assert!(found.contains(words), "{found}\n{}", self.said);
            }
        }
        assert!(folder.join("out/report.html").exists());
        let log = Recording::read(folder.join("out/run.mcap")).unwrap();
        assert!(log.damage.is_none());
        opspace(folder, &["replay", "out"]).exits(0);
    }
}

/// True if the log of a run has rows.
fn is_running(folder: &Path) -> bool {
    fs::metadata(folder.join("out/run.mcap")).is_ok_and(|file| file.len() > 0)
        && fs::metadata(folder.join("calls")).is_ok()
}

/// Each signal that can be caught, during a run in real time: `stop` is called, the log is closed, the exit code is 130.
#[test]
fn signals_stop_the_robot() {
    for signal in
        ["-HUP", "-INT", "-QUIT", "-USR1", "-USR2", "-ALRM", "-TERM", "-TSTP", "-VTALRM", "-PROF", "-IO"]
    {
        let folder = scratch();
        let run = start(folder.path(), "remote = false", &["--duration-s", "2000"]);
        run.wait_for(is_running);
        sleep(Duration::from_millis(300));
        run.signal(signal);
        let ended = run.end().exits(130).stops(1, 2).says(&["interrupted at", "the log is closed"]);
        assert_eq!(ended.summary.as_ref().unwrap()["interrupted"], Value::Bool(true), "{signal}");
        ended.logs(folder.path(), None);
    }
}

/// A read that does not return: after one signal, the stop of another thread ends it, if the driver has one; otherwise the
/// second signal ends the program, with a closed log.
#[test]
fn blocked_read_ends_by_signals() {
    let blocked = |folder: &Path| read(folder.join("calls")).contains("blocked");
    let keys = "at = 500, blocks_s = 1000.0";
    for (remote, signals) in [(true, 1), (false, 2)] {
        let folder = scratch();
        let run = start(folder.path(), &format!("{keys}, remote = {remote}"), &["--duration-s", "2000"]);
        run.wait_for(is_running);
        run.wait_for(blocked);
        for _ in 0..signals {
            run.signal("-INT");
            sleep(Duration::from_millis(50));
        }
        let ended = run.end().exits(1);
        if remote {
            let ended = ended.stops(1, 3);
            assert_eq!(ended.calls.iter().filter(|call| *call == "remote stop").count(), 1);
            ended.logs(folder.path(), Some("the arm was stopped from another thread"));
        } else {
            ended.says(&["could not be reached"]).logs(folder.path(), Some("could not be reached"));
        }
    }
}

/// Time since 1970, s.
fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

/// Time of the first of these calls on the computer's clock, since 1970, s.
#[track_caller]
fn time_of(folder: &Path, call: &str) -> f64 {
    let times = read(folder.join("calls.times"));
    let found = times.lines().find_map(|line| line.strip_prefix(call)?.strip_prefix(' '));
    found.unwrap_or_else(|| panic!("no {call}:\n{times}")).parse().unwrap()
}

/// A second signal during a stop whose setpoints come to rest slowly. Compared: the time that the stop takes on the robot's
/// clock, with one signal and with two.
#[test]
fn second_signal_ends_a_slow_stop() {
    let slow = "robot.profile.default.setpoint_limits={ reaction = \"clamp\", joint = { shoulder = { acceleration_rad_per_s2 = 0.1 } } }";
    let swing = "task.swing.joint-tracking.reference.sinusoid.joints.shoulder=[{ amplitude_rad = 1.0, frequency_hz = 0.05 }]";
    let options = ["--duration-s", "2000", "--set", slow, "--set", swing];
    let stops_in = |signals: u32| {
        let folder = scratch();
        let run = start(folder.path(), "remote = false", &options);
        run.wait_for(is_running);
        sleep(Duration::from_secs(3));
        for _ in 0..signals {
            run.signal("-INT");
            sleep(Duration::from_millis(100));
        }
        let ended = run.end().exits(130).stops(1, 2).says(&["interrupted at", "the log is closed"]);
        ended.logs(folder.path(), None);
        let log = Recording::read(folder.path().join("out/run.mcap")).unwrap();
        let phases = log.channel("tick").unwrap().signal("phase").unwrap();
        phases.rows().filter(|phase| phase[0] == 5.0).count()
    };
    let (one, two) = (stops_in(1), stops_in(2));
    assert!(two > 0 && 2 * two < one, "{two} cycles of the stop with two signals, {one} with one");
}

/// Times from a fault to the stop of the robot, by the computer's clock. The contract is 0.1 s and the period, after the longest
/// tolerated dropout if nothing but silence says that the robot is lost; a loaded computer may take 1 s more.
#[test]
fn stops_follow_faults_soon() {
    const LOADED_S: f64 = 1.0;
    let within = |folder: &Path, from_s: f64, stop: &str, most_s: f64| {
        let took_s = time_of(folder, stop) - from_s;
        assert!((0.0..most_s + LOADED_S).contains(&took_s), "{stop}: {took_s} s, {most_s} s are allowed");
    };
    // A dead device.
    let folder = scratch();
    let ended = start(folder.path(), "at = 500, dead = true", &[]).end().exits(1).stops(1, 2);
    ended.logs(folder.path(), Some("the arm does not answer"));
    within(folder.path(), time_of(folder.path(), "failed"), "stop", 0.101);
    // A read that blocks.
    let blocks = "at = 500, blocks_s = 1000.0, remote = true";
    let dropout_s = |seconds: f64| format!("robot.safety.max_dropout_s={seconds:?}");
    let folder = scratch();
    start(folder.path(), blocks, &["--set", &dropout_s(0.3)]).end().exits(1).stops(1, 3);
    within(folder.path(), time_of(folder.path(), "blocked"), "remote stop", 0.401);
    within(folder.path(), time_of(folder.path(), "remote stop"), "stop", 0.101);
    // A read that blocks, and a signal: the dropout is not waited for.
    let folder = scratch();
    let run = start(folder.path(), blocks, &["--set", &dropout_s(10.0)]);
    run.wait_for(is_running);
    run.wait_for(|folder| read(folder.join("calls")).contains("blocked"));
    let from_s = now_s();
    run.signal("-INT");
    run.end().exits(1).stops(1, 3);
    within(folder.path(), from_s, "remote stop", 0.101);
}

/// A read that does not return, without any signal: with a stop of another thread, without one, and one that returns in time.
#[test]
pub fn blocked_read_ends_by_itself() {
    let cases = [
        ("blocks_s = 1000.0, remote = true", "the arm was stopped from another thread", 1),
        ("blocks_s = 1000.0", "could not be reached", 0),
        ("blocks_s = 0.6", "by the computer's clock", 1),
    ];
    for (keys, fault, least) in cases {
        let folder = scratch();
        let run = start(folder.path(), &format!("at = 500, {keys}"), &[]);
        let mut ended = run.end().exits(1);
        if least > 0 {
            ended = ended.stops(least, 3);
        }
        ended.logs(folder.path(), Some(fault));
    }
}

/// Panics of the driver in each of its functions during a run: its stop is called, at most once more after a panic of its own.
#[test]
fn panics_of_a_driver_stop_the_robot() {
    let cases = [
        ("read", 2, "panicked in `read`", (1, 2)),
        ("read", 500, "panicked in `read`", (1, 2)),
        ("write", 500, "panicked in `write`", (1, 2)),
        ("stop", 1, "panicked in `stop`", (2, 3)),
        ("every stop", 1, "panicked in `stop`, and again", (2, 4)),
    ];
    for (place, at, fault, (least, most)) in cases {
        let folder = scratch();
        let run = start(folder.path(), &format!("panic = {place:?}, at = {at}"), &[]);
        run.end().exits(1).stops(least, most).logs(folder.path(), Some(fault));
    }
}

/// Panics and an error outside the run: before it there is no log, after it all results are complete.
#[test]
fn failures_outside_the_run_are_said() {
    let run = |keys: &str| {
        let folder = scratch();
        let ended = start(folder.path(), keys, &[]).end().exits(1);
        (folder, ended)
    };
    let (folder, ended) = run("panic = \"read\", at = 1");
    let ended = ended.stops(1, 1).says(&["the robot cannot be read", "panicked in `read`"]);
    assert!(ended.summary.is_none() && !folder.path().join("out/run.mcap").exists());
    let (_, ended) = run("panic = \"open\"");
    ended.says(&["the driver, while it opened the robot, panicked"]);
    for (keys, words) in [
        ("panic = \"close\"", "the driver failed after it: it panicked while it closed the robot"),
        ("error = true", "the driver failed after it: the arm did not close"),
    ] {
        let (folder, ended) = run(keys);
        ended.stops(1, 2).says(&[words]).logs(folder.path(), None);
    }
}

/// Samples at another rate than declared, and times that are no times, stop the robot; each names the numbers.
#[test]
fn wrong_clocks_stop_the_robot() {
    let cases = [
        ("spacing = 2.0", "samples came 2 ms apart on the robot's clock, but its period is 1 ms"),
        ("spacing = 0.5", "samples came 0.5 ms apart on the robot's clock, but its period is 1 ms"),
        ("at = 500, time_s = \"inf\"", "the robot's clock went from 0.499 s to inf s"),
        ("at = 500, time_s = \"nan\"", "the robot's clock went from 0.499 s to NaN s"),
        ("at = 2, time_s = \"nan\"", "the robot's clock reads NaN s in the first sample"),
        ("at = 500, time_s = \"0.1\"", "the robot's clock went from 0.499 s to 0.1 s"),
        ("at = 500, time_s = \"1e9\"", "the robot's clock went from 0.499 s to 1000000000 s"),
    ];
    for (keys, fault) in cases {
        let folder = scratch();
        let ended = start(folder.path(), keys, &[]).end().exits(1).stops(1, 2);
        ended.logs(folder.path(), Some(fault));
        assert!(ended.summary.unwrap()["missed_cycles"].as_u64().unwrap() <= 400, "{keys}");
    }
}

/// A period that is no period is refused before the first cycle.
#[test]
fn declared_period_is_compared() {
    for period in ["nan", "inf", "0.0", "-0.001", "0.002"] {
        let folder = scratch();
        let ended = start(folder.path(), &format!("declared_s = {period:?}"), &[]).end().exits(2);
        let ended = ended.says(&["interface period in seconds: robot.toml states 0.001"]);
        assert!(ended.summary.is_none() && !folder.path().join("out/run.mcap").exists(), "{period}");
    }
}

/// Compared: the late commands of a run whose driver blocks for 0.1 s once, with that time, in summary, log and page.
#[test]
fn late_commands_are_counted_logged_and_shown() {
    const BLOCKS_MS: f64 = 100.0;
    let folder = scratch();
    let ended = start(folder.path(), "at = 400, blocks_s = 0.1, real_time = \"off\"", &[]).end().exits(0);
    let summary = ended.summary.unwrap();
    let of = |key: &str| summary["real_time"][key].clone();
    assert_eq!(of("scheduling"), "real-time scheduling is off");
    assert!(of("late_cycles").as_u64().unwrap() >= 1);
    assert!(of("longest_lateness_ms").as_f64().unwrap() >= BLOCKS_MS - 2.0, "{summary}");
    assert!(of("period_ms")["max"].as_f64().unwrap() >= BLOCKS_MS - 1.0);
    let log = Recording::read(folder.path().join("out/run.mcap")).unwrap();
    let intervals_ns = log.channel("timing").unwrap().signal("sample_interval").unwrap();
    let longest_ns = intervals_ns.rows().map(|row| row[0]).fold(0.0, f64::max);
    assert!(longest_ns >= 1e6 * (BLOCKS_MS - 1.0), "{longest_ns} ns");
    assert!(read(folder.path().join("out/report.html")).contains(" commands were late ("));
    opspace(folder.path(), &["replay", "out"]).exits(0);
}
