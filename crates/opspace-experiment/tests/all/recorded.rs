//! Recorded paths: read relative to the task file, executed, stored in the log, and replayed from it.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_experiment::Progress;
use opspace_experiment::run::replay::replay;
use opspace_experiment::{Experiment, Files, RunOptions};
use opspace_log::Recording;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Path from rest to rest, out and back.
const PATH: &str = "time_s,x_m,y_m,z_m
10.0,0.50,0.1,0.9
10.2,0.50,0.12,0.9
10.5,0.51,0.15,0.92
10.8,0.50,0.12,0.93
11.0,0.50,0.1,0.93
";

const TASK: &str = r#"
robot = "ROBOT"
duration_s = 1.2
settle_s = 0.2
priority = ["hand", "rest"]
start_rad = { shoulder_pitch = -0.45, shoulder_roll = -0.35, shoulder_yaw = 0.25, elbow = -1.35 }

[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }
reference.recorded = { file = "paths/hand.csv" }

[task.rest.joint-posture]
frequency_rad_per_s = 6.325
damping_ratio = 0.79
"#;

/// Creates a folder with the task and its recorded path.
fn folder(path: &str) -> TempDir {
    let folder = TempDir::new().unwrap();
    let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots/asimo-arm");
    fs::write(folder.path().join("task.toml"), TASK.replace("ROBOT", robot.to_str().unwrap())).unwrap();
    fs::create_dir(folder.path().join("paths")).unwrap();
    fs::write(folder.path().join("paths/hand.csv"), path).unwrap();
    folder
}

fn load(folder: &TempDir) -> Result<Experiment, opspace_experiment::FileError> {
    Experiment::load(Files::Disk, &folder.path().join("task.toml"), None, RunOptions::default(), &[])
}

fn run(experiment: &Experiment) -> Recording {
    let sink = std::io::Cursor::new(Vec::new());
    let finished = experiment.run(sink, &Progress::default()).unwrap();
    Recording::from_bytes(&finished.sink.into_inner()).unwrap()
}

/// Compared: the logged reference at the times of the samples, and the samples relative to the start; all numbers of
/// the log, and the run recomputed from the log after the files were removed.
#[test]
fn recorded_path_run_replays() {
    let files = folder(PATH);
    let recording = run(&load(&files).unwrap());
    drop(files);

    let channel = recording.channel("tick").unwrap();
    let reference = channel.signal("hand.reference").unwrap();
    let phase = channel.signal("phase").unwrap();
    let began = (0..channel.len()).find(|&k| phase.row(k)[0] > 0.0).unwrap();
    let (start_s, start) = (channel.time_s[began], reference.row(began));
    for (time_s, sample) in [(0.2, [0.0, 0.02, 0.0]), (0.5, [0.01, 0.05, 0.02]), (1.0, [0.0, 0.0, 0.03])] {
        let at = (began..channel.len()).find(|&k| channel.time_s[k] - start_s > time_s - 1e-6).unwrap();
        for i in 0..3 {
            // The control cycle is at the time of the sample, except for the rounding of its time stamp.
            assert!((reference.row(at)[i] - start[i] - sample[i]).abs() < 1e-6, "{time_s} s, axis {i}");
        }
    }

    let again = Experiment::of_log(&recording).unwrap();
    assert_eq!(again.task().recordings[Path::new("paths/hand.csv")].text(), PATH);
    let replayed = replay(&again, &recording).unwrap();
    assert_eq!((replayed.differing, replayed.compared), (0, replayed.logged));
    assert!(replayed.compared > 1000 && replayed.unmatched.is_empty());
}

/// Compared: a log and its replay with another path, because the path is part of the run.
#[test]
fn replay_with_another_path_differs() {
    let mut recording = run(&load(&folder(PATH)).unwrap());
    let path = recording.attachments.iter_mut().find(|a| a.name == "recorded/paths/hand.csv").unwrap();
    path.data = PATH.replace("0.15", "0.151").into_bytes();
    let replayed = replay(&Experiment::of_log(&recording).unwrap(), &recording).unwrap();
    assert!(replayed.differing > 500, "{}", replayed.differing);
    recording.attachments.retain(|a| a.name != "recorded/paths/hand.csv");
    let error = Experiment::of_log(&recording).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("recorded/paths/hand.csv"), "{error}");
}

/// A mistake in the path is reported at its line in the path file, an unreadable path file at the line of the task
/// file.
#[test]
fn recorded_path_errors_name_their_line() {
    let line = 1 + TASK.lines().position(|line| line.contains("hand.csv")).unwrap();
    for (path, file, at, said) in [
        (
            PATH.replace("0.51,", "0.5l,"),
            "hand.csv",
            Some(4),
            "`x_m`: expected a number from -1e9 to 1e9, got '0.5l'",
        ),
        (PATH.replace("z_m", "zm"), "hand.csv", Some(1), "unknown column `zm`"),
        (PATH.lines().take(2).collect::<Vec<_>>().join("\n"), "hand.csv", None, "1 samples"),
    ] {
        let error = load(&folder(&path)).map(|_| ()).unwrap_err();
        assert!(error.path().ends_with(file) && error.line() == at, "{error}");
        assert!(error.message().contains(said), "{error}");
    }
    let unknown = load(&folder(&PATH.replace("z_m", "zm"))).map(|_| ()).unwrap_err();
    assert_eq!(unknown.help(), Some("did you mean `z_m`?"));

    let missing = folder(PATH);
    fs::rename(missing.path().join("paths/hand.csv"), missing.path().join("paths/hands.csv")).unwrap();
    let error = load(&missing).map(|_| ()).unwrap_err();
    assert!(error.path().ends_with("task.toml") && error.line() == Some(line), "{error}");
    assert!(error.message().contains("hand.csv") && error.message().contains("no such file"), "{error}");
    assert!(error.help().is_some_and(|help| help.contains("hands.csv")), "{error:?}");
}
