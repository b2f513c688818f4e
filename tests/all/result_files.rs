//! Files of results: what a command may write, replace and remove.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use crate::cli_common::{command, opspace, project, read, read_json, run, scratch};
use opspace_experiment::{Experiment, Files, Progress, RunError, RunOptions};
use opspace_log::Recording;
use opspace_report::folder::in_folder;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

fn task() -> String {
    project("tasks/gravity-compensation.toml")
}

/// Bytes of all files below a folder, by name.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.extend(contents(&path));
        } else {
            all.push((path.display().to_string(), fs::read(&path).unwrap()));
        }
    }
    all.sort();
    all
}

/// Compared: all files of the folder before and after commands that name an input, a log or another output as their
/// output.
#[test]
fn output_that_is_an_input_or_a_log_is_refused() {
    let folder = scratch();
    run(folder.path(), "out", "gravity-compensation", &[]);
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("robot")).unwrap();
    for name in ["robot.toml", "asimo-arm.urdf"] {
        fs::copy(project(&format!("robots/asimo-arm/{name}")), at("robot").join(name)).unwrap();
    }
    fs::copy(project("tasks/joint-tracking.toml"), at("task.toml")).unwrap();
    std::os::unix::fs::symlink("out/run.mcap", at("link.mcap")).unwrap();
    let before = contents(folder.path());
    let log = "out/run.mcap";
    let cases: [&[&str]; 14] = [
        &["replay", log, "--json", log],
        &["replay", "link.mcap", "--json", log],
        &["replay", log, "--json", "link.mcap"],
        &["replay", log, "--task", "task.toml", "--json", "task.toml"],
        &["report", log, "-o", log],
        &["report", log, "--json", "out/report.html"],
        &["report", log, "-o", "page.html", "--json", "page.html"],
        &["report", log, "-o", "task.toml"],
        &["check", "task.toml", "--json", "task.toml"],
        &["check", "task.toml", "--json", "robot/robot.toml"],
        &["model", "robot/asimo-arm.urdf", "--json", "robot/asimo-arm.urdf"],
        &["identify", "robot", "-o", "robot", "--force"],
        &["run", "task.toml", "--robot", "robot", "--json", "robot/robot.toml"],
        &["run", "task.toml", "--robot", "robot", "-o", "new", "--json", "new/run.mcap"],
    ];
    for arguments in cases {
        let ran = opspace(folder.path(), arguments).exits(2);
        assert!(
            ran.stdout.is_empty() && ran.stderr.contains("choose another"),
            "{arguments:?}: {}",
            ran.stderr
        );
        assert!(contents(folder.path()) == before, "{arguments:?} changed a file");
    }
}

/// Starts a run of a task that lasts long enough, and waits until it writes its log.
fn running(folder: &Path, arguments: &[&str], log: &Path) -> std::process::Child {
    let mut child = command(folder, arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begun = Instant::now();
    while !log.exists() {
        assert!(begun.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none(), "no log");
        sleep(Duration::from_millis(5));
    }
    child
}

/// Checks a second run into the folder of one that is under way: by `--out`, by `--force`, and by the default folder.
#[test]
fn folder_in_use_is_refused() {
    let folder = scratch();
    let task = task();
    let long = ["run", &task, "--duration-s", "3000"];
    let default = folder.path().join("runs/gravity-compensation-asimo-arm-position");
    let mut child = running(folder.path(), &long, &default.join("run.mcap"));
    let default = default.display().to_string();
    for more in [&[][..], &["--out", &default], &["--out", &default, "--force"]] {
        let arguments = [&["run", &task, "--duration-s", "2"], more].concat();
        opspace(folder.path(), &arguments).exits(2).says(&["another opspace"]);
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let entries = fs::read_dir(folder.path().join("runs")).unwrap().count();
    assert_eq!(entries, 1, "nothing was moved aside");
    opspace(folder.path(), &["run", &task, "--duration-s", "2"]).exits(0).says(&["moved the previous run"]);
}

/// Compared: the summary of a run whose log was replaced by another one before it ended, and that of the same run
/// undisturbed.
#[test]
fn summary_is_that_of_the_log_the_run_wrote() {
    let folder = scratch();
    let experiment = |seed| {
        let options = RunOptions { seed: Some(seed), duration_s: Some(2.0), ..RunOptions::default() };
        let task = project("tasks/compliant-x.toml");
        Experiment::load(Files::Disk, task.as_ref(), None, options, &[]).expect("an experiment")
    };
    let progress = Progress::default();
    let other = folder.path().join("other");
    in_folder(&experiment(2), &other, |log| experiment(2).run(log, &progress)).unwrap();
    let disturbed = folder.path().join("disturbed");
    let summary = in_folder(&experiment(1), &disturbed, |log| {
        let result = experiment(1).run(log, &progress);
        fs::rename(other.join("run.mcap"), disturbed.join("run.mcap")).unwrap();
        result
    })
    .unwrap();
    let alone = folder.path().join("alone");
    let expected = in_folder(&experiment(1), &alone, |log| experiment(1).run(log, &progress)).unwrap();
    assert_eq!(summary.metrics, expected.metrics);
}

/// Checks the files that `--force` removes: those of the earlier run or suite; and a result's name taken by a file that
/// no run wrote.
#[test]
fn force_removes_only_results() {
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    run(folder.path(), "out", "gravity-compensation", &[]);
    fs::write(
        at("suite.toml"),
        format!(
            "title = \"one\"\n[[run]]\ntasks = [\"{}\"]\nbackend = \"torque\"\ncontroller = \"osc\"\n",
            task()
        ),
    )
    .unwrap();
    let suite = ["bench", "suite.toml", "--out", "bench", "--force"];
    opspace(folder.path(), &suite).exits(0);
    assert_eq!(
        read_json(at("bench/bench.json"))["logs"],
        serde_json::json!(["gravity-compensation-torque.mcap"])
    );
    for kept in ["out/notes.txt", "out/other.mcap", "bench/other.mcap", "bench/mine.json"] {
        fs::write(at(kept), "mine").unwrap();
    }
    fs::rename(at("bench/gravity-compensation-torque.mcap"), at("bench/renamed.mcap")).unwrap();
    opspace(folder.path(), &suite).exits(0);
    opspace(folder.path(), &["run", &task(), "--duration-s", "2", "--out", "out", "--force"]).exits(0);
    for kept in ["out/notes.txt", "out/other.mcap", "bench/other.mcap", "bench/mine.json"] {
        assert_eq!(read(at(kept)), "mine", "{kept}");
    }
    assert!(at("bench/renamed.mcap").exists());
    for name in ["report.html", "robot.toml"] {
        fs::create_dir_all(at("foreign")).unwrap();
        fs::write(at("foreign").join(name), "mine").unwrap();
    }
    let identify = ["identify", &project("robots/asimo-arm"), "--joint", "elbow", "--out", "urdf"];
    fs::create_dir(at("urdf")).unwrap();
    fs::write(at("urdf/asimo-arm.urdf"), "mine").unwrap();
    opspace(folder.path(), &identify).exits(2).says(&["asimo-arm.urdf", "differs"]);
    assert_eq!(read(at("urdf/asimo-arm.urdf")), "mine");
    for arguments in [["run", &task()], ["identify", &project("robots/asimo-arm")]] {
        let arguments = [&arguments[..], &["--out", "foreign", "--force"]].concat();
        opspace(folder.path(), &arguments).exits(2).says(&["foreign/", "not a result"]);
    }
}

/// Checks a run whose log reaches the limit of file sizes: exit code 3, a table of what was saved, and a log that can be
/// read up to there.
#[test]
fn log_cut_short_is_summarised_and_exits_with_3() {
    let folder = scratch();
    let limited = |script: &str| {
        let output = Command::new("sh")
            .args(["-c", script, "sh", env!("CARGO_BIN_EXE_opspace"), &task()])
            .current_dir(folder.path())
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8(output.stdout).unwrap(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    // Blocks of 512 bytes.
    let (code, table, said) =
        limited("ulimit -f 800; exec \"$1\" run \"$2\" --duration-s 10 --out out --json -");
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("not saved completely: run.mcap"), "{said}");
    let summary: Value = serde_json::from_str(&table).unwrap();
    assert!(summary["rows_lost"].as_u64().unwrap() > 0, "{summary}");
    assert!(summary["not_saved"][0].as_str().unwrap().starts_with("run.mcap: "), "{summary}");
    let recording = Recording::read(folder.path().join("out/run.mcap")).unwrap();
    assert!(recording.damage.is_some() && recording.channels.iter().any(|channel| channel.len() > 100));
    let (code, _, said) = limited("ulimit -f 1; exec \"$1\" run \"$2\" --out none");
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("can't write the log") && !folder.path().join("none/run.mcap").exists(), "{said}");
}

/// Checks a sink that fails in the middle, as a full disk does: the error has the outcome of the run.
#[test]
fn failing_sink_reports_the_outcome_of_the_run() {
    struct Full(usize);
    impl std::io::Write for Full {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 = self.0.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::StorageFull)?;
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let options = RunOptions { duration_s: Some(3.0), ..RunOptions::default() };
    let experiment =
        Experiment::load(Files::Disk, task().as_ref(), None, options, &[]).expect("an experiment");
    match experiment.run(Full(400_000), &Progress::default()) {
        Err(RunError::LogCutShort { record, rows, .. }) => {
            assert!(record.fault.is_none() && rows > 3000, "{record:?} after {rows} rows");
        }
        other => panic!("{:?}", other.map(|result| result.written)),
    }
}

#[test]
fn folder_that_cannot_be_created_exits_with_2() {
    let folder = scratch();
    fs::write(folder.path().join("file"), "").unwrap();
    let arguments = ["run", &task(), "--duration-s", "2", "--out", "file/out"];
    opspace(folder.path(), &arguments).exits(2).says(&["file/out", "cannot be written"]);
}

/// Checks inputs without end or of another kind, which must be refused at once.
#[test]
fn endless_input_is_refused() {
    let folder = scratch();
    let urdf = project("robots/planar-2-link/planar-2-link.urdf");
    let cases: [&[&str]; 6] = [
        &["replay", "/dev/zero"],
        &["report", "/dev/zero"],
        &["check", "/dev/zero"],
        &["run", "/dev/zero"],
        &["model", "/dev/zero"],
        &["model", &urdf, "--tip", "tip", "--samples", "/dev/zero"],
    ];
    for arguments in cases {
        opspace(folder.path(), arguments).exits(2);
    }
}

/// Checks a file whose name would colour the terminal and reverse the text after it.
#[test]
fn names_of_files_are_escaped_on_the_terminal() {
    let folder = scratch();
    let name = "\u{1b}[31mred\u{202e}.toml";
    fs::copy(project("tasks/joint-tracking.toml"), folder.path().join(name)).unwrap();
    let ran = opspace(folder.path(), &["check", name]);
    let all = ran.stdout + &ran.stderr;
    assert!(all.contains("\\u{1b}[31mred\\u{202e}") && !all.contains(['\u{1b}', '\u{202e}']), "{all}");
}
