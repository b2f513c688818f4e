//! Experiments with several robots: mistakes in their files and in suites of them, and suites on one and two threads.

#![expect(clippy::unwrap_used, reason = "a test")]

use crate::cli_common::{Ran, opspace, project, read, read_json, scratch};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// An experiment of half a second.
const EXPERIMENT: &str = r#"duration_s = 0.5
settle_s = 0.1
[expect]
"hands.energy_extracted_j" = { at_most = 0.05 }
"hands.drift_m" = { at_most = 0.05 }
[robots.leader]
task = "TASKS/handle.toml"
[robots.follower]
task = "TASKS/follow-wall.toml"
[couplings.hands]
leader = { robot = "leader", task = "hand" }
follower = { robot = "follower", task = "hand" }
channel = "link"
teleoperation = { reflect = "measured-force" }
[channels.link]
delay_s = 0.01
"#;

const SUITE: &str = r#"title = "s"
[[run]]
experiments = ["hands.toml"]
"#;

/// Creates a folder with the experiment `hands.toml` and the suite `suite.toml`.
fn folder(experiment: &str, suite: &str) -> tempfile::TempDir {
    let folder = scratch();
    fs::write(folder.path().join("hands.toml"), experiment.replace("TASKS", &project("tasks"))).unwrap();
    fs::write(folder.path().join("suite.toml"), suite).unwrap();
    folder
}

fn check(experiment: &str) -> Ran {
    let folder = folder(experiment, SUITE);
    opspace(folder.path(), &["check", "hands.toml"])
}

fn bench(folder: &Path, options: &[&str]) -> Ran {
    opspace(folder, &[&["bench", "suite.toml"], options].concat())
}

/// Results without computing times, which are not reproducible.
fn without_timing(mut json: Value) -> Value {
    let clear = |run: &mut Value| {
        for robot in run["robots"].as_object_mut().unwrap().values_mut() {
            robot["timing"] = Value::Null;
        }
    };
    match json["rows"].as_array_mut() {
        Some(rows) => rows.iter_mut().for_each(clear),
        None => clear(&mut json),
    }
    json
}

/// Mistakes in the file of an experiment: file, line, and what is allowed.
#[test]
fn mistakes_in_an_experiment_have_their_line() {
    check(EXPERIMENT).exits(0);
    let changed = |from: &str, to: &str| {
        assert!(EXPERIMENT.contains(from), "{from}");
        EXPERIMENT.replacen(from, to, 1)
    };
    let follower = "follower = { robot = \"follower\"";
    let law = "reflect = \"measured-force\"";
    let cases = [
        (changed(follower, "follower = { robot = \"folower\""), ":12: ", "did you mean 'follower'?"),
        (changed(follower, "follower = { robot = \"leader\""), ":12: ", "coupled with itself"),
        (changed("channel = \"link\"", "channel = \"lnk\""), ":13: ", "did you mean 'link'?"),
        (
            format!(
                "{EXPERIMENT}[couplings.twice]\nleader = {{ robot = \"leader\", task = \"hand\" }}\n\
                 follower = {{ robot = \"follower\", task = \"hand\" }}\nteleoperation = {{}}\n"
            ),
            ":18: ",
            "already coupled",
        ),
        (
            format!("{EXPERIMENT}[robots.third]\ntask = \"TASKS/handle.toml\"\n"),
            ":17: ",
            "not coupled with another",
        ),
        (
            changed(
                "task = \"TASKS/follow-wall.toml\"",
                "task = \"TASKS/follow-wall.toml\"\nset = [\"task.hand.coupled.axes=['x', 'z']\"]",
            ),
            ":11: ",
            "different rows",
        ),
        (
            changed(law, "reflect = { waves = { impedance_ns_per_m = 20.0 } }") + "jitter_s = 0.01\n",
            ":14: ",
            "constant delay only",
        ),
        (
            changed(law, "reflect = { waves = { impedance_ns_per_m = 20.0 } }").replace(
                "task = \"TASKS/follow-wall.toml\"",
                "task = \"TASKS/follow-wall.toml\"\nset = [\"robot.profile.a-med.servo_ticks_per_cycle=8\"]",
            ),
            ":15: ",
            "a multiple of the other",
        ),
        (changed("hands.drift_m", "hands.drift"), ":5: ", "did you mean 'drift_m'?"),
        (changed("hands.drift_m", "hand.drift_m"), ":5: ", "did you mean 'hands'?"),
        (changed("{ at_most = 0.05 }", "{}"), ":4: ", "`at_most`"),
        (
            changed(
                "task = \"TASKS/handle.toml\"",
                "task = \"TASKS/handle.toml\"\nset = [\n\"task.hand.coupled.dampin_ns_per_m=5.0\"]",
            ),
            ":9: ",
            "did you mean `damping_ns_per_m`?",
        ),
        (changed(law, "reflects = \"position\""), ":14: ", "did you mean `reflect`?"),
        (changed("delay_s = 0.01", "delay_s = 0.5"), ":16: ", "hold_after_s"),
        (changed("delay_s = 0.01", "jitter_s = 0.2"), ":16: ", "timeout_s"),
    ];
    let mut wrong = Vec::new();
    for (experiment, line, words) in cases {
        let stderr = check(&experiment).exits(2).stderr;
        for said in [&format!("hands.toml{line}"), words] {
            if !stderr.contains(said) {
                wrong.push(format!("'{said}' isn't said:\n{stderr}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.concat());
}

/// A coupling without passivity control runs, and is told before; one with wave variables is passive without.
#[test]
fn coupling_without_passivity_control_is_told() {
    let off = EXPERIMENT.replace("\"measured-force\" }", "\"measured-force\", passivity = \"off\" }");
    check(&off).exits(0).prints(&["hands.toml:14: ", "passivity control is off", "help: "]);
    let waves = off.replace("\"measured-force\"", "{ waves = { impedance_ns_per_m = 20.0 } }");
    for quiet in [EXPERIMENT, &waves] {
        let stdout = check(quiet).exits(0).stdout;
        assert!(!stdout.contains("passivity"), "{stdout}");
    }
}

/// Mistakes in suites of experiments: file, line, and what is allowed.
#[test]
fn mistakes_in_a_suite_of_experiments_have_their_line() {
    let with = |text: &str| format!("{SUITE}{text}\n");
    let cases = [
        (with("tasks = [\"hands.toml\"]"), "suite.toml:3: ", "not both"),
        (with("[[run]]\ntasks = [\"hands.toml\"]"), "suite.toml:5: ", "two suite files"),
        (with("[[run]]\nlabel = \"empty\""), "suite.toml:4: ", "add `tasks = "),
        (with("backend = \"torque\""), "suite.toml:4: ", "robots.NAME.backend=..."),
        (format!("columns = [\"position-rms\"]\n{SUITE}"), "suite.toml:1: ", "columns of its own"),
        (SUITE.replace("hands", "hand"), "suite.toml:3: ", "no such file"),
        (
            with("override = [\"leader.task.hand.coupled.dampin_ns_per_m=5.0\"]"),
            "suite.toml:4: ",
            "damping_ns_per_m",
        ),
        (with("override = [\"robots.leader.backend=hydraulic\"]"), "suite.toml:4: ", "`torque`"),
        (with("profiles = [\"a-medium\"]"), "a-medium", "a-med"),
    ];
    for (suite, place, words) in cases {
        let folder = folder(EXPERIMENT, &suite);
        bench(folder.path(), &[]).exits(2).says(&[place, words]);
        assert!(!folder.path().join("runs").exists(), "nothing was run");
    }
    let folder = folder(EXPERIMENT, SUITE);
    bench(folder.path(), &["--shard", "1/2"]).exits(2).says(&["--shard", "suites of tasks"]);
}

/// Compared: rows of a suite on one and two threads, on two threads again, and with logs and without. The table has the
/// worst drift over the seeds, the largest one.
#[test]
fn suite_of_experiments_gives_the_same_bits_on_any_number_of_threads() {
    let suite = format!(
        "{SUITE}seeds = [1, 2]\ngrid = {{ \"robots.leader.backend\" = [\"position\", \"torque\"] }}\n"
    );
    let folder = folder(EXPERIMENT, &suite);
    let rows = |name: &str, jobs: &str| {
        let ran = bench(folder.path(), &["--out", name, "--jobs", jobs]).exits(0);
        (without_timing(read_json(folder.path().join(name).join("bench.json"))), ran.stdout)
    };
    let (one, table) = rows("one", "1");
    assert_eq!(rows("two", "2").0, one);
    assert_eq!(rows("again", "2").0, one);
    let labels: Vec<&str> =
        one["rows"].as_array().unwrap().iter().map(|row| row["label"].as_str().unwrap()).collect();
    assert_eq!(labels, ["backend=position", "backend=position", "backend=torque", "backend=torque"]);
    let drift_mm = |run: usize| 1e3 * one["rows"][run]["couplings"]["hands"]["drift_m"].as_f64().unwrap();
    assert!(drift_mm(0) != drift_mm(1), "the seeds matter");
    let worst = drift_mm(0).max(drift_mm(1));
    let row = table.lines().find(|line| line.contains("backend=position")).unwrap();
    let shown = row.split_whitespace().filter_map(|cell| cell.parse::<f64>().ok());
    assert!(shown.into_iter().any(|shown| (shown - worst).abs() < 1e-3 * worst), "{worst} mm in {row}");

    let options = ["--set", "robots.leader.backend=position", "--seed", "1", "--out", "run"];
    opspace(folder.path(), &[&["run", "hands.toml"], &options[..]].concat()).exits(0);
    let run = without_timing(read_json(folder.path().join("run/summary.json")));
    for (key, of_suite) in one["rows"][0].as_object().unwrap() {
        if !["label", "overrides", "robots"].contains(&key.as_str()) {
            assert_eq!(&run[key], of_suite, "{key}");
        }
    }
    let page = read(folder.path().join("one/hands/report.html"));
    assert!(page.contains("Couplings") && folder.path().join("one/hands/leader/run.mcap").exists());
}

/// A missed expectation ends with 1, `--force` replaces the folders of the robots, and a suite that was cut off continues.
#[test]
fn suite_of_experiments_is_continued_and_replaced() {
    let missed = "variant = [{ label = \"strict\", override = [\"expect={'hands.drift_m' = { at_most = 1e-9 }}\"] }]\n";
    let folder = folder(EXPERIMENT, &format!("{SUITE}seeds = [1, 2]\n{missed}"));
    let out = folder.path().join("out");
    let ran = bench(folder.path(), &["--out", "out", "--csv", "rows.csv"]).exits(1);
    assert!(
        ran.stdout.contains("2 of 2 failed") && ran.stdout.contains("FAILED hands, strict"),
        "{}",
        ran.stdout
    );
    let csv = read(folder.path().join("rows.csv"));
    assert!(
        csv.lines().next().unwrap().contains("coupling.hands.drift_m") && csv.lines().count() == 3,
        "{csv}"
    );

    // As if the process had ended after the first run.
    let all = read(out.join("rows.jsonl"));
    let kept: Vec<&str> = all.lines().take(2).collect();
    fs::write(out.join("rows.jsonl"), kept.join("\n") + "\n").unwrap();
    fs::remove_file(out.join("bench.json")).unwrap();
    let again = bench(folder.path(), &["--out", "out", "--csv", "rows.csv"]).exits(1);
    again.says(&["continued: 1 runs are complete"]);
    assert_eq!(read(folder.path().join("rows.csv")).lines().count(), 3, "the earlier table is replaced");
    assert_eq!(read(out.join("rows.jsonl")).lines().count(), 3);

    bench(folder.path(), &["--out", "out"]).exits(2).says(&["--force"]);
    fs::write(out.join("hands/leader/notes.txt"), "mine").unwrap();
    bench(folder.path(), &["--out", "out", "--force"]).exits(2).says(&["choose another folder"]);
    assert_eq!(read(out.join("hands/leader/notes.txt")), "mine", "nothing else is removed");
    fs::remove_file(out.join("hands/leader/notes.txt")).unwrap();
    fs::remove_dir_all(out.join("hands")).unwrap();
    bench(folder.path(), &["--out", "out", "--force"]).exits(1);
    bench(folder.path(), &["--out", "out", "--force"]).exits(1);

    let run = ["run", "hands.toml", "--out", "run", "--quiet"];
    opspace(folder.path(), &run).exits(0);
    opspace(folder.path(), &[&run[..], &["--force"]].concat()).exits(0);
}
