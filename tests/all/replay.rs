//! `opspace replay`: all runs are reproduced bit for bit, and a difference between log and run is detected and
//! located at the number.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use crate::cli_common::{Ran, opspace, project, read_json, run, scratch};
use crate::coupled;
use opspace_experiment::run::replay::{replay as replay_recording, replay_log};
use opspace_experiment::{Experiment, Extensions};
use opspace_log::header::{GAPS, LOG};
use opspace_log::{Channel, ChannelData, Header, LogFile, Pace, Recording, record};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

fn replay(log: &Path) -> Ran {
    opspace(log.parent().unwrap(), &["replay", log.to_str().unwrap()])
}

/// Compared: all commands recomputed from the measurements in the log, and the log.
#[track_caller]
fn check_replay(task: &str, options: &[&str]) {
    let folder = scratch();
    let log = run(folder.path(), "out", task, options);
    let said = replay(&log).exits(0).stdout;
    assert!(said.contains("ticks are equal, bit for bit"), "{said}");
    let ticks = Recording::read(&log).unwrap().channel("tick").unwrap().len();
    assert!(ticks > 400 && said.contains(&format!("all {ticks} ticks")), "{said}");
}

#[test]
fn position_robot_under_torque_control_replays() {
    check_replay("compliant-x", &[]);
}

#[test]
fn torque_robot_replays() {
    check_replay("cartesian-tracking", &["--backend", "torque"]);
}

#[test]
fn inverse_kinematics_replays() {
    check_replay("cartesian-tracking", &["--controller", "ik"]);
}

#[test]
fn inverse_kinematics_with_lead_replays() {
    check_replay("joint-tracking", &["--controller", "ik-lead", "--profile", "b-soft"]);
}

#[test]
fn run_with_overrides_replays() {
    let set = "task.hand.gains.damping_ratio=0.7";
    check_replay(
        "compliant-x",
        &["--seed", "7", "--set", set, "--set", "robot.simulated.true_over_nominal.kp=1.02"],
    );
}

#[test]
fn run_with_missed_cycles_replays() {
    let dead = "robot.simulated.bus.dropouts=[{ at_s = 3.0, duration_s = 0.3 }]";
    let lost = "robot.simulated.bus.lost_cycles_share=0.02";
    let options = ["--set", dead, "--set", lost, "--transformer", "emulation+current"];
    check_replay("cartesian-tracking", &options);
    check_replay("cartesian-tracking", &["--set", lost, "--backend", "torque"]);
    check_replay("joint-tracking", &["--set", dead, "--controller", "ik-lead"]);
}

/// Settings of a push that exceeds the torques of the arm.
const PUSH: [&str; 2] = [
    "environment.operator.spring.motion.random.rms_m=2.0",
    "environment.operator.spring.stiffness_n_per_m=3000",
];

#[test]
fn faulted_run_replays_with_its_fault() {
    for backend in ["position", "torque"] {
        let folder = scratch();
        let task = project("tasks/compliant-x.toml");
        let arguments =
            ["run", &task, "--backend", backend, "--out", "out", "--set", PUSH[0], "--set", PUSH[1]];
        opspace(folder.path(), &arguments).exits(1).says(&["stopped at", "joint"]);
        replay(&folder.path().join("out/run.mcap")).exits(0);
    }
}

/// Writes a recording as a new log, with rows modified by `change`.
fn rewritten(recording: &Recording, to: PathBuf, change: impl Fn(&mut ChannelData)) -> PathBuf {
    let own = |name: &str| name != LOG && name != GAPS;
    let header = Header {
        metadata: recording.metadata.iter().filter(|(name, _)| own(name)).cloned().collect(),
        attachments: recording.attachments.clone(),
        ..Header::default()
    };
    let channels = recording.channels.iter().map(|c| Channel { layout: c.layout.clone(), rate_hz: 1e3 });
    let sink = File::create(&to).unwrap();
    let (mut recorder, writer) = record(sink, header, channels.collect(), Pace::Simulated).unwrap();
    for (index, channel) in recording.channels.iter().enumerate() {
        let mut channel = channel.clone();
        change(&mut channel);
        for k in 0..channel.len() {
            recorder.wait_for_space();
            recorder.push(index, channel.time_s[k], channel.row(k));
        }
    }
    drop(recorder);
    let (written, _) = writer.finish().unwrap();
    assert_eq!(written.dropped, 0);
    to
}

/// Index of a signal's element in the rows of a channel.
fn place(channel: &ChannelData, signal: &str, element: &str) -> usize {
    let before = channel.layout.signals.iter().take_while(|s| s.name != signal);
    let offset: usize = before.map(|s| s.elements.len()).sum();
    let within = channel.signal(signal).expect(signal).elements().iter().position(|e| e == element);
    offset + within.expect(element)
}

/// Adds `by` to one number of the channel `tick`.
fn nudge(tick: usize, signal: &'static str, element: &'static str, by: f64) -> impl Fn(&mut ChannelData) {
    move |channel| {
        if channel.layout.channel == "tick" {
            let at = tick * channel.layout.width() + place(channel, signal, element);
            channel.rows[at] += by;
        }
    }
}

fn value(recording: &Recording, tick: usize, signal: &str, element: &str) -> f64 {
    let channel = recording.channel("tick").unwrap();
    channel.row(tick)[place(channel, signal, element)]
}

#[test]
fn changed_command_is_reported_exactly() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let whole = Recording::read(&log).unwrap();
    let same = rewritten(&whole, folder.path().join("same.mcap"), |_| ());
    replay(&same).exits(0);

    let (tick, by) = (1234, 1e-12);
    let changed = folder.path().join("changed.mcap");
    let changed = rewritten(&whole, changed, nudge(tick, "torque_desired", "elbow", by));
    let (is, was) = (value(&whole, tick, "torque_desired", "elbow"), {
        value(&Recording::read(&changed).unwrap(), tick, "torque_desired", "elbow")
    });
    assert_ne!(is.to_bits(), was.to_bits(), "the change is one that f64 can hold");
    let said = replay(&changed).exits(1).stdout;
    let expected =
        format!("first at tick {tick} ({:.6} s): torque_desired of 'elbow' was {was:?}, is {is:?}", {
            whole.channel("tick").unwrap().time_s[tick]
        });
    assert!(said.contains("differs in 1 of ") && said.contains(&expected), "{said}\n{expected}");

    let json = opspace(folder.path(), &["replay", "changed.mcap", "--json", "-"]).exits(1).json();
    let first = &json["first_difference"];
    assert_eq!((first["tick"].as_u64(), first["signal"].as_str()), (Some(1234), Some("torque_desired")));
    assert_eq!((first["logged"].as_f64(), first["recomputed"].as_f64()), (Some(was), Some(is)));
}

/// One changed number in the log of one robot of two: the folder fails, and the other log is equal.
#[test]
fn changed_log_of_one_robot_fails_its_folder() {
    let folder = scratch();
    coupled::run(folder.path(), &["--out", "out"]).exits(0);
    let log = folder.path().join("out/follower/run.mcap");
    let whole = Recording::read(&log).unwrap();
    rewritten(&whole, log, nudge(523, "torque_desired", "elbow", 1e-9));
    let said = opspace(folder.path(), &["replay", "out"]).exits(1).stdout;
    assert!(said.contains("out/leader/run.mcap: all 700 ticks are equal"), "{said}");
    assert!(said.contains("out/follower/run.mcap: differs in 1 of 700 ticks, first at tick 523"), "{said}");
}

/// A modified measurement: all values computed from it differ in the replay.
#[test]
fn changed_measurement_is_located_by_cycle_and_joint() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let whole = Recording::read(&log).unwrap();
    for joint in ["shoulder_roll", "elbow"] {
        let changed = folder.path().join(format!("{joint}.mcap"));
        let changed = rewritten(&whole, changed, nudge(900, "q", joint, 1e-9));
        let said = replay(&changed).exits(1).stdout;
        let wanted = [" ticks, first at tick 900 ", &format!(" of '{joint}' was "), ", is "];
        assert!(wanted.iter().all(|w| said.contains(w)), "{said}");
    }
}

/// A log that differs and is corrupted: the difference takes precedence over the corruption.
#[test]
fn differing_truncated_log_fails() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let whole = Recording::read(&log).unwrap();
    let changed = folder.path().join("changed.mcap");
    let changed = rewritten(&whole, changed, nudge(700, "torque_desired", "elbow", 1.0));
    let bytes = fs::read(&changed).unwrap();
    fs::write(&changed, &bytes[..bytes.len() - 100]).unwrap();
    replay(&changed).exits(1).says(&["damaged"]);
}

/// A modified byte at any position, or a missing end: the log is never reported as complete. Its intact part is
/// compared and is equal.
#[test]
fn corruption_is_reported_and_intact_part_compared() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let bytes = fs::read(&log).unwrap();
    let damaged = folder.path().join("damaged.mcap");
    let mut codes = Vec::new();
    for part in 0..12 {
        let at = bytes.len() * part / 12;
        let mut flipped = bytes.clone();
        flipped[at] ^= 0x10;
        for (case, bytes) in [("flipped", flipped.as_slice()), ("cut", &bytes[..at])] {
            fs::write(&damaged, bytes).unwrap();
            let ran = replay(&damaged);
            assert!([2, 3].contains(&ran.code), "{case} at {at}: {}\n{}{}", ran.code, ran.stdout, ran.stderr);
            assert!(!ran.stderr.is_empty(), "{case} at {at}: nothing is said");
            let report = opspace(folder.path(), &["report", "damaged.mcap", "-o", "page.html"]);
            assert_eq!(report.code, ran.code, "{case} at {at}: {}", report.stderr);
            codes.push(ran.code);
        }
    }
    // Only corruption before the first row can make a log completely unreadable.
    assert!(codes.iter().filter(|c| **c == 3).count() > 20, "{codes:?}");
}

#[test]
fn replay_of_another_task_is_marked_what_if() {
    let folder = scratch();
    run(folder.path(), "out", "compliant-x", &[]);
    let other = project("tasks/cartesian-tracking.toml");
    let said = opspace(folder.path(), &["replay", "out", "--task", &other]).exits(0).stdout;
    assert!(said.starts_with("open loop: commands of 'cartesian-tracking'"), "{said}");
    assert!(said.contains("torque_desired of 'elbow'") && said.contains(" Nm rms"), "{said}");

    // The task of the log gives no difference in any joint, another task gives differences in all joints.
    let own = project("tasks/compliant-x.toml");
    let difference = |task: &str| {
        let json = opspace(folder.path(), &["replay", "out", "--task", task, "--json", "-"]).exits(0).json();
        assert_eq!(json["open_loop"], true);
        let joints = json["rms_difference"]["torque_desired"].as_object().unwrap().clone();
        joints.values().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>()
    };
    assert_eq!(difference(&own), [0.0; 4]);
    assert!(difference(&other).iter().all(|rms| *rms > 0.1));
}

/// A replay with changed files says where and why it ends, and its page plots logged and recomputed torques.
#[test]
fn what_if_states_its_end_and_plots_torques() {
    let folder = scratch();
    run(folder.path(), "out", "compliant-x", &[]);
    let what_if = |arguments: &[&str]| opspace(folder.path(), &[&["replay", "out"], arguments].concat());
    let damping = ["--set", "task.hand.cartesian.gains.damping_ratio=0.5", "--report", "page.html"];
    let ran = what_if(&damping).exits(0);
    assert!(
        ran.stdout.contains("open loop") && ran.stdout.contains("ticks: its duration of 2 s is over."),
        "{}",
        ran.stdout
    );
    assert!(ran.stdout.contains("torque_desired of 'elbow'"), "{}", ran.stdout);
    let page = std::fs::read_to_string(folder.path().join("page.html")).unwrap();
    for word in ["Logged and recomputed torque", "recomputed − logged", "elbow", "duration of 2 s is over"]
    {
        assert!(page.contains(word), "{word}");
    }
    let shorter = what_if(&["--set", "duration_s=1.6"]).exits(0).stdout;
    assert!(shorter.contains("ticks: its duration of 1.6 s is over."), "{shorter}");
    let strict = "robot.safety.watchdog.torque_deviation_share=1e-4";
    let end = what_if(&["--set", strict, "--json", "-"]).exits(0).json()["end"].as_str().unwrap().to_owned();
    assert!(end.contains("it would have been stopped at ") && end.contains("s of control: "), "{end}");
    what_if(&["--report", "a.html"]).exits(2).says(&["add --task, --controller, --transformer or --set"]);
    what_if(&["--set", "task.hand.cartesian.gains.damping_rato=0.5"]).exits(2).says(&["damping_ratio"]);
}

/// Text without the line breaks of notes.
fn folded(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Compared: the commands of a run on a log, and those in the log. With the same task all are equal, targets included: those
/// of the follower are what its leader sent. The new log replays bit for bit.
#[test]
fn run_on_a_log_repeats_its_commands() {
    let folder = scratch();
    run(folder.path(), "out", "compliant-x", &[]);
    let teleop = [
        "run",
        &project("tasks/experiments/teleop-free.toml"),
        "--duration-s",
        "2",
        "--out",
        "both",
        "--quiet",
    ];
    opspace(folder.path(), &teleop).exits(0);
    let task = project("tasks/compliant-x.toml");
    // The task of the follower is that of its log: the file of the experiment states a part of it.
    let runs: [(&str, &[&str]); 2] = [
        ("out", &["run", &task, "--backend", "replay", "--log", "out"]),
        ("both/follower", &["replay", "both/follower", "--set", "settle_s=0.5"]),
    ];
    for (log, start) in runs {
        let ran = opspace(folder.path(), &[start, &["--out", "repeated", "--force"]].concat()).exits(0);
        let said = folded(&ran.stdout);
        assert!(said.contains("All commands are those of the log, bit for bit."), "{said}");
        let summary = read_json(folder.path().join("repeated/summary.json"));
        assert_eq!(summary["replay"]["commands_part_after_s"], serde_json::Value::Null, "{log}");
        assert_eq!(summary["plant"], format!("log {log}/run.mcap"));
        let said = opspace(folder.path(), &["replay", "repeated"]).exits(0).stdout;
        assert!(said.contains("are equal, bit for bit"), "{said}");
    }
}

/// Compared: `run --backend replay` and `replay --task`, which are one run; and the time from which on the commands differ,
/// with the first cycle of control, as this task desires other torques from the start.
#[test]
fn run_on_a_log_says_from_when_on_it_is_a_what_if() {
    let folder = scratch();
    run(folder.path(), "out", "compliant-x", &[]);
    let task = project("tasks/gravity-compensation.toml");
    let wide = ["--set", "robot.safety.watchdog.torque_deviation_share=100"];
    let runs: [&[&str]; 2] =
        [&["run", &task, "--backend", "replay", "--log", "out"], &["replay", "out", "--task", &task]];
    let summaries = runs.map(|start| {
        let name = start[0];
        let ran = opspace(folder.path(), &[start, &wide[..], &["--out", name]].concat());
        assert!(folded(&ran.stdout).contains("only a what-if"), "{}{}", ran.stdout, ran.stderr);
        assert!(folder.path().join(name).join("report.html").exists());
        let mut summary = read_json(folder.path().join(name).join("summary.json"));
        summary["timing"].take();
        summary
    });
    assert_eq!(summaries[0], summaries[1]);
    let part_s = summaries[0]["replay"]["commands_part_after_s"].as_f64().unwrap();
    let tare_s = 0.2;
    assert!((tare_s..tare_s + 0.01).contains(&part_s), "{part_s}");
    let report = opspace(folder.path(), &["report", "run", "--json", "-"]).exits(0).stdout;
    assert!(report.contains("commands_part_after_s"), "{report}");
}

/// A stop that was requested in the log stops a run on it.
#[test]
fn run_on_a_log_gets_its_stop_requests() {
    let folder = scratch();
    run(folder.path(), "out", "compliant-x", &[]);
    let recording = Recording::read(folder.path().join("out/run.mcap")).unwrap();
    rewritten(&recording, folder.path().join("stopped.mcap"), |tick| {
        if tick.layout.channel == "tick" {
            let at = place(tick, "stop_requested", "value");
            let width = tick.layout.width();
            tick.rows[1000 * width + at] = 1.0;
        }
    });
    let task = project("tasks/compliant-x.toml");
    opspace(folder.path(), &["run", &task, "--backend", "replay", "--log", "stopped.mcap", "--out", "again"]);
    let summary = read_json(folder.path().join("again/summary.json"));
    assert_eq!(summary["interrupted"], true);
    assert!((summary["interrupted_time_s"].as_f64().unwrap() - 0.8).abs() < 0.01, "{summary}");
}

#[test]
fn run_on_a_log_needs_a_log() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    opspace(folder.path(), &["run", &task, "--backend", "replay"]).exits(2).says(&["add --log LOG"]);
    opspace(folder.path(), &["run", &task, "--log", "out"]).exits(2).says(&["--log is for --backend replay"]);
}

#[test]
fn non_log_file_is_refused_by_name() {
    let folder = scratch();
    fs::write(folder.path().join("a.mcap"), "").unwrap();
    fs::write(folder.path().join("run.toml"), "a = 1").unwrap();
    fs::create_dir(folder.path().join("empty")).unwrap();
    for command in ["replay", "report"] {
        let at = |path: &str| opspace(folder.path(), &[command, path]).exits(2);
        at("b.mcap").says(&["b.mcap: there is no such file", "did you mean `a.mcap`?"]);
        at("a.mcap").says(&["a.mcap: this is not an MCAP file"]);
        at("run.toml").says(&["run.toml: this is not an MCAP file"]);
        at("empty").says(&["empty/run.mcap: there is no such file"]);
    }
}

/// A log written by opspace 0.1.0: the message contains the version that can read it, and the log is not changed.
#[test]
fn old_log_error_names_version_that_reads_it() {
    let folder = scratch();
    let log = folder.path().join("run.mcap");
    fs::copy(project("tests/logs/opspace-0.1.0.mcap"), &log).unwrap();
    let before = fs::read(&log).unwrap();
    for command in ["replay", "report"] {
        let ran = opspace(folder.path(), &[command, "run.mcap"]).exits(2);
        ran.says(&[
            "run.mcap",
            "read it with opspace 0.1.0",
            concat!("this is opspace ", env!("CARGO_PKG_VERSION")),
        ]);
    }
    assert_eq!(fs::read(&log).unwrap(), before);
    assert!(!folder.path().join("report.html").exists());
}

/// Compared: a replay in segments of any size, and that of the whole log in memory; also of a log that a fault ended, and of
/// a changed one.
#[test]
fn replay_in_segments_is_that_of_the_whole_log() {
    let folder = scratch();
    let lost = "robot.simulated.bus.lost_cycles_share=0.05";
    let logs = [
        run(folder.path(), "whole", "compliant-x", &[]),
        run(folder.path(), "lossy", "joint-tracking", &["--set", lost]),
    ];
    for log in logs {
        let recording = Recording::read(&log).unwrap();
        let experiment = Experiment::of_log(&recording).unwrap();
        let whole = replay_recording(&experiment, &recording).unwrap();
        assert!(whole.compared > 1000 && whole.compared == whole.logged, "{whole:?}");
        assert_eq!((whole.differing, &whole.first_difference), (0, &None));
        for values in [1, 5000, 77_777] {
            let file = LogFile::open(&log).unwrap().segment_values(values);
            assert_eq!(replay_log(&experiment, &file).unwrap(), whole, "segments of {values} values");
        }
        // Another gain: the same first difference, wherever a segment ends.
        let settings = ["robot.safety.torque_ramp_s=0.7".to_owned()];
        let other = Experiment::of_log_changed(&Extensions::default(), &recording, &settings).unwrap();
        let whole = replay_recording(&other, &recording).unwrap();
        assert!(whole.differing > 100, "{whole:?}");
        let file = LogFile::open(&log).unwrap().segment_values(5000);
        assert_eq!(replay_log(&other, &file).unwrap(), whole);
    }
}
