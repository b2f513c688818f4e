//! `opspace log`: contents, recovery, export and comparison, with logs of real runs.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{opspace, project, read, run, scratch};
use opspace_backend::{Layout, Signal, signal_names};
use opspace_log::{Channel, Header, Pace, Recording, record};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;

/// Two runs with the same file and seed differ in no channel except that of wall-clock times; with another seed they
/// differ in others.
#[test]
fn two_runs_differ_only_in_the_channel_of_wall_clock_times() {
    let folder = scratch();
    for (name, options) in [("a", &[][..]), ("b", &[]), ("c", &["--seed", "2"])] {
        run(folder.path(), name, "compliant-x", options);
    }
    let json = opspace(folder.path(), &["log", "diff", "a", "b", "--json", "-"]).exits(0).json();
    let differing = |json: &Value| -> Vec<String> {
        let channels = json["channels"].as_array().unwrap().iter();
        let differing = channels.filter(|channel| channel["differs"] == true);
        differing.map(|channel| channel["topic"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(differing(&json), ["/opspace/timing"]);
    assert!(json["channels"].as_array().unwrap().len() > 10, "{json}");
    let text = opspace(folder.path(), &["log", "diff", "a", "b"]).exits(0).stdout;
    assert!(text.contains("/opspace/timing: differs first in message 0"), "{text}");
    assert!(text.contains("tick_time is ") && text.contains("(wall-clock times: not counted)"), "{text}");
    let other = opspace(folder.path(), &["log", "diff", "a", "c"]).exits(1).stdout;
    assert!(other.contains("metadata 'opspace.run': seed is 1 and 2"), "{other}");
    assert!(other.contains("/opspace/truth: differs first in message "), "{other}");
    assert!(other.ends_with("the logs differ\n"), "{other}");
    let rows = |name: &str| Recording::read(folder.path().join(name).join("run.mcap")).unwrap();
    let timing = rows("a").channel("timing").unwrap().clone();
    let ticks_ns = timing.signal("tick_time").unwrap();
    assert!(timing.len() > 1900 && ticks_ns.rows().flatten().all(|ns| *ns > 0.0));
    assert!(rows("a").tick().unwrap().signal("tick_time").is_none());
}

#[test]
fn info_lists_the_contents() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &["--seed", "3"]);
    let json = opspace(folder.path(), &["log", "info", "out", "--json", "-"]).exits(0).json();
    let text = |key: &str| json[key].as_str().unwrap().to_owned();
    assert!(text("task").ends_with("compliant-x.toml") && text("robot").ends_with("robot.toml"), "{json}");
    assert_eq!([text("backend"), text("seed"), text("outcome")], ["position", "3", "completed"]);
    assert_eq!(
        (text("version"), &json["closed"]),
        (env!("CARGO_PKG_VERSION").to_owned(), &Value::Bool(true))
    );
    assert_eq!(json["bytes"].as_u64().unwrap(), fs::metadata(&log).unwrap().len());
    let recording = Recording::read(&log).unwrap();
    let cycles = recording.tick().unwrap().len();
    assert_eq!((json["cycles"].as_u64(), json["missed_cycles"].as_f64()), (Some(cycles as u64), Some(0.0)));
    let channel = |topic: &str| {
        let channels = json["channels"].as_array().unwrap().iter();
        channels.clone().find(|channel| channel["topic"] == topic).unwrap()["messages"].as_u64().unwrap()
    };
    assert_eq!((channel("/opspace/tick"), channel("/robot_description")), (cycles as u64, 1));
    let attached: Vec<&str> =
        json["attachments"].as_array().unwrap().iter().map(|a| a["name"].as_str().unwrap()).collect();
    assert_eq!(attached, ["robot.toml", "task.toml", "robot.urdf"]);

    let text = opspace(folder.path(), &["log", "info", "out"]).exits(0).stdout;
    for word in
        ["closed by its writer", "/opspace/servo", "opspace.Servo", "robot.urdf", "outcome: completed"]
    {
        assert!(text.contains(word), "{word}:\n{text}");
    }
    let bytes = fs::read(&log).unwrap();
    fs::write(folder.path().join("cut.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    let text = opspace(folder.path(), &["log", "info", "cut.mcap"]).exits(3).stdout;
    assert!(text.contains("not closed") && text.contains("damaged, from byte "), "{text}");
    let old =
        opspace(folder.path(), &["log", "info", &project("tests/logs/opspace-0.1.0.mcap")]).exits(0).stdout;
    assert!(old.contains("version: 0.1.0") && old.contains("/opspace/tick"), "{old}");
}

/// A truncated log and one with a damaged chunk: `info`, `replay` and `report` read the recovered log without complaint,
/// and what was lost is said. Inputs and existing files are never replaced.
#[test]
fn recovered_log_replays_without_complaint() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let bytes = fs::read(&log).unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("cut.mcap"), &bytes[..bytes.len() * 2 / 3]).unwrap();
    let mut corrupt = bytes.clone();
    corrupt[bytes.len() * 2 / 3] ^= 1;
    fs::write(at("corrupt.mcap"), &corrupt).unwrap();
    for (damaged, lost) in [
        ("cut.mcap", "lost: unknown, because the log has no end; 2 s of control"),
        ("corrupt.mcap", " cycles, "),
    ] {
        let new = format!("new-{damaged}");
        let ran = opspace(folder.path(), &["log", "recover", damaged, "-o", &new]).exits(3);
        assert!(ran.stdout.contains("saved: ") && ran.stdout.contains(lost), "{}", ran.stdout);
        let cycles = Recording::read(at(&new)).unwrap().tick().unwrap().len();
        assert!(cycles >= 1000 && ran.stdout.contains(&format!("saved: {cycles} cycles")), "{}", ran.stdout);
        let info = opspace(folder.path(), &["log", "info", &new]).exits(0);
        assert!(info.stdout.contains("recovered from a damaged log") && info.stderr.is_empty());
        let replay = opspace(folder.path(), &["replay", &new]).exits(0);
        assert!(replay.stdout.contains(&format!("all {cycles} ticks are equal")) && replay.stderr.is_empty());
        let report = opspace(folder.path(), &["report", &new, "-o", "page.html"]).exits(0);
        assert!(report.stderr.is_empty(), "{}", report.stderr);
        let before = fs::read(at(&new)).unwrap();
        opspace(folder.path(), &["log", "recover", damaged, "-o", &new]).exits(2).says(&["already exists"]);
        opspace(folder.path(), &["log", "recover", damaged, "-o", damaged]).exits(2).says(&["is an input"]);
        assert_eq!(fs::read(at(&new)).unwrap(), before);
    }
    let ran = opspace(folder.path(), &["log", "recover", "out", "-o", "whole.mcap"]).exits(0);
    assert!(ran.stdout.contains("whole\n") && ran.stdout.contains("lost: 0 cycles"), "{}", ran.stdout);
    opspace(folder.path(), &["log", "diff", "out", "whole.mcap"]).exits(0);
}

/// A damaged attachment: the message names it, all rows can be exported and recovered.
#[test]
fn damaged_attachment_is_named_and_costs_no_row() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let mut bytes = fs::read(&log).unwrap();
    let text = b"[task.hand.cartesian]";
    let place = bytes.windows(text.len()).position(|window| window == text).unwrap();
    bytes[place + 3] ^= 1;
    fs::write(folder.path().join("damaged.mcap"), &bytes).unwrap();
    let named = ["the attachment 'task.toml'", "all rows are readable"];
    opspace(folder.path(), &["replay", "damaged.mcap"])
        .exits(2)
        .says(&named)
        .says(&["lacks the attached task.toml"]);
    opspace(folder.path(), &["log", "export", "damaged.mcap", "-o", "rows.csv"]).exits(3).says(&named);
    let whole = Recording::read(&log).unwrap();
    assert_eq!(read(folder.path().join("rows.csv")).lines().count(), whole.tick().unwrap().len() + 1);
    let text = opspace(folder.path(), &["log", "diff", "out", "damaged.mcap"]).exits(3).stdout;
    assert!(text.ends_with("the rest could not be compared\n") && !text.contains("equal, except"), "{text}");
    let ran = opspace(folder.path(), &["log", "recover", "damaged.mcap", "-o", "new.mcap"]).exits(3);
    assert!(
        ran.stdout.contains("lost: 0 cycles") && ran.stdout.contains("lost: the attachment 'task.toml'"),
        "{}",
        ran.stdout
    );
}

#[test]
fn export_writes_csv_and_replaces_only_on_request() {
    let folder = scratch();
    let log = run(folder.path(), "out", "joint-tracking", &[]);
    let export =
        |arguments: &[&str]| opspace(folder.path(), &[&["log", "export", "out"], arguments].concat());
    export(&["-o", "rows.csv", "--channel", "truth"]).exits(0);
    let text = read(folder.path().join("rows.csv"));
    assert!(text.starts_with("time_s,q.shoulder_pitch_rad,"), "{}", text.lines().next().unwrap());
    let recording = Recording::read(&log).unwrap();
    let truth = recording.channel("truth").unwrap();
    let last: Vec<f64> =
        text.lines().last().unwrap().split(',').map(|field| field.parse().unwrap()).collect();
    assert_eq!(last[0].to_bits(), truth.time_s.last().unwrap().to_bits());
    assert_eq!(last[1..], truth.row(truth.len() - 1)[..]);
    assert_eq!(export(&["-o", "-", "--channel", "truth"]).exits(0).stdout, text);
    export(&["-o", "rows.csv"]).exits(2).says(&["rows.csv: already exists; use --force"]);
    assert_eq!(read(folder.path().join("rows.csv")), text);
    export(&["-o", "rows.csv", "--force"]).exits(0);
    assert!(read(folder.path().join("rows.csv")).starts_with("time_s,stop_requested,"));
    fs::write(folder.path().join("notes.csv"), "my notes").unwrap();
    export(&["-o", "notes.csv", "--force"])
        .exits(2)
        .says(&["notes.csv: exists and is not a CSV file of a log"]);
    export(&["-o", "out/run.mcap", "--force"]).exits(2).says(&["is an input of this command"]);
    export(&["-o", "a.csv", "--channel", "tik"])
        .exits(2)
        .says(&["no channel 'tik'", "tick, timing, truth, servo"]);
}

/// Compared: all topics and fields that the layouts for viewers name, and those of a log of their task.
#[test]
fn layouts_of_viewers_name_topics_and_fields_of_a_log() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    run(folder.path(), "held", "lift-load", &[]);
    let topics = |out: &str| -> BTreeSet<String> {
        let json = opspace(folder.path(), &["log", "info", out, "--json", "-"]).exits(0).json();
        let channels = json["channels"].as_array().unwrap().iter();
        let written = channels.filter(|channel| channel["messages"] != 0);
        written.map(|channel| channel["topic"].as_str().unwrap().to_owned()).collect()
    };
    let mut known = topics("out");
    // A mass that hangs at the arm.
    known.extend(topics("held"));
    for channel in Recording::read(&log).unwrap().channels {
        for signal in &channel.layout.signals {
            let field = format!("/opspace/{}.{}", channel.layout.channel, signal.name.replace('.', "_"));
            known.extend(signal.elements.iter().map(|element| format!("{field}.{element}")));
            known.insert(field);
        }
    }
    let foxglove = read(project("docs/viewers/foxglove.json"));
    let plotjuggler = read(project("docs/viewers/plotjuggler.xml"));
    let named: Vec<String> =
        foxglove.split('"').filter(|text| text.starts_with('/')).map(str::to_owned).collect();
    let curves: Vec<String> = plotjuggler
        .split("curve name=\"")
        .skip(1)
        .map(|rest| rest.split('"').next().unwrap().to_owned())
        .collect();
    assert!(named.len() > 20 && curves.len() > 10);
    for name in &named {
        assert!(known.contains(name), "{name} is not in a log");
    }
    let slashed: BTreeSet<String> = known.iter().map(|name| name.replace('.', "/")).collect();
    for name in &curves {
        assert!(slashed.contains(name), "{name} is not in a log");
    }
}

/// Checks the contents of a log whose signals have no elements: those of a program that writes the layout itself.
#[test]
fn info_of_a_log_without_elements_is_printed() {
    let folder = scratch();
    let names = [signal_names::MISSED_CYCLES, signal_names::FAULT];
    let signals = names.map(|name| Signal::new::<&str>(name, "1", &[])).to_vec();
    let channels = vec![Channel { layout: Layout { channel: "tick".to_owned(), signals }, rate_hz: 1000.0 }];
    let sink = fs::File::create(folder.path().join("empty.mcap")).unwrap();
    let (mut recorder, writer) = record(sink, Header::default(), channels, Pace::Simulated).unwrap();
    recorder.push(0, 0.0, &[]);
    drop(recorder);
    assert_eq!(writer.finish().unwrap().0.records, 1);
    let json = opspace(folder.path(), &["log", "info", "empty.mcap", "--json", "-"]).exits(0).json();
    assert_eq!((json["cycles"].as_u64(), json["missed_cycles"].as_f64()), (Some(1), Some(0.0)));
}

/// Compared: the exported path of a frame, and the positions of the log at the same times; and a task reads it.
#[test]
fn exported_path_is_that_of_the_log() {
    let folder = scratch();
    let log = run(folder.path(), "out", "compliant-x", &[]);
    let export =
        |arguments: &[&str]| opspace(folder.path(), &[&["log", "export", "out"], arguments].concat());
    let text = export(&["-o", "-", "--path", "hand", "--every-s", "0.1"]).exits(0).stdout;
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("time_s,x_m,y_m,z_m,qw,qx,qy,qz"));
    let samples: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|field| field.parse().unwrap()).collect()).collect();
    let recording = Recording::read(&log).unwrap();
    let tick = recording.tick().unwrap();
    let (phase, position) = (tick.signal("phase").unwrap(), tick.signal("hand.position").unwrap());
    let begin = phase.rows().position(|row| row[0] == 1.0).unwrap();
    // Two seconds of control at 1 kHz, and its last cycle.
    assert_eq!(samples.len(), 21);
    for (k, sample) in samples.iter().enumerate() {
        let row = (begin + 100 * k).min(tick.len() - 1);
        assert!((sample[0] - (tick.time_s[row] - tick.time_s[begin])).abs() < 1e-6, "{k}: {sample:?}");
        for axis in 0..3 {
            assert!((sample[1 + axis] - position.row(row)[axis]).abs() < 1e-9, "{k}: {sample:?}");
        }
    }
    export(&["-o", "path.csv", "--path", "rest"]).exits(2).says(&["no frame of a task 'rest'", "hand"]);
    export(&["-o", "path.csv", "--path", "hand", "--every-s", "0"]).exits(2).says(&["--every-s"]);
    export(&["-o", "path.csv", "--every-s", "0.1"]).exits(2);
    export(&["-o", "path.csv", "--path", "hand", "--channel", "truth"]).exits(2);
}
