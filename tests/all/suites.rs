//! Suites: grids, seeds and defaults of the file, continuation, shards, comparison with a baseline, and CSV.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test")]

use crate::cli_common::{Ran, circle_folder, command, opspace, read, read_json};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

fn bench(folder: &Path, options: &[&str]) -> Ran {
    opspace(folder, &[&["bench", "suite.toml", "--jobs", "2"], options].concat())
}

/// Text of JSON results without computing times and the table without them.
fn without_timing(path: impl AsRef<Path>) -> String {
    let mut json = read_json(path);
    for row in json["rows"].as_array_mut().unwrap() {
        row["timing"] = Value::Null;
    }
    serde_json::to_string_pretty(&json).unwrap()
}

fn column(rows: &Value, key: &str) -> Vec<Value> {
    rows["rows"].as_array().unwrap().iter().map(|row| row[key].clone()).collect()
}

const GRID: &str = r#"
title = "grid"
columns = ["position-rms", "torque-max"]
[grid]
"task.tip.gains.damping_ratio" = [0.7, 1.0]
robot.simulated.true_over_nominal.inertia = [0.9, 1.1]
[[run]]
tasks = ["circle.toml"]
seeds = { from = 1, to = 2 }
"#;

/// Compared: rows of crossed and zipped grids, and lists written by hand; the label in the table and the settings of a
/// row; a run that opts out.
#[test]
fn grid_runs_every_combination_or_pairs() {
    let folder = circle_folder(GRID);
    let table = bench(folder.path(), &["--json", "rows.json"]).exits(0).stdout;
    // Each setting has a column.
    let has_settings = |line: &str| {
        let cells: Vec<&str> = line.split_whitespace().collect();
        cells.windows(2).any(|pair| pair == ["0.7", "1.1"])
    };
    assert!(table.contains("damping") && table.lines().any(has_settings), "{table}");
    let rows = read_json(folder.path().join("rows.json"));
    let sets: Vec<String> = column(&rows, "overrides").iter().map(|set| set[0].to_string()).collect();
    assert_eq!(sets.len(), 8);
    assert_eq!(column(&rows, "seed"), [1, 2, 1, 2, 1, 2, 1, 2].map(Value::from));
    assert_eq!(
        rows["rows"][2]["overrides"],
        serde_json::json!([
            "task.tip.gains.damping_ratio=0.7",
            "robot.simulated.true_over_nominal.inertia=1.1"
        ])
    );
    let zipped = GRID.replace("[grid]", "grid_mode = \"zip\"\n[grid]")
        + "[[run]]\ntasks = [\"circle.toml\"]\ngrid = {}\nlabel = \"plain\"\n";
    fs::write(folder.path().join("suite.toml"), zipped).unwrap();
    bench(folder.path(), &["--json", "rows.json"]).exits(0);
    let labels = column(&read_json(folder.path().join("rows.json")), "label");
    let [a, b] = ["damping_ratio=0.7, inertia=0.9", "damping_ratio=1.0, inertia=1.1"];
    assert_eq!(labels, [a, a, b, b, "plain"].map(Value::from));
}

/// A grid whose key contains the name of the profile, with a run per profile.
#[test]
fn grid_key_contains_the_profile() {
    let folder = circle_folder(
        "title = \"s\"\nprofiles = [\"default\"]\n[grid]\n\"robot.profile.{profile}.servo_ticks_per_cycle\" = [1, 2]\n\
         [[run]]\ntasks = [\"circle.toml\"]\nlabel = \"rate\"\nbackend = \"torque\"\n",
    );
    bench(folder.path(), &["--json", "rows.json"]).exits(0);
    let rows = read_json(folder.path().join("rows.json"));
    assert_eq!(column(&rows, "ratio"), [1, 2].map(Value::from));
    assert_eq!(
        column(&rows, "label"),
        [1, 2].map(|n| Value::from(format!("rate, servo_ticks_per_cycle={n}")))
    );
    assert_eq!(rows["rows"][0]["overrides"][0], "robot.profile.default.servo_ticks_per_cycle=1");
}

/// Compared: a suite without optional keys, and `opspace run` without options.
#[test]
fn suite_without_keys_equals_run_without_options() {
    let folder = circle_folder("title = \"defaults\"\n[[run]]\ntasks = [\"circle.toml\"]\n");
    bench(folder.path(), &["--json", "rows.json"]).exits(0);
    let mut row = read_json(folder.path().join("rows.json"))["rows"][0].clone();
    let mut run = opspace(folder.path(), &["run", "circle.toml", "--json", "-"]).exits(0).json();
    for summary in [&mut row, &mut run] {
        summary["timing"] = Value::Null;
    }
    assert_eq!(row, run);
}

/// Mistakes in settings, grids, seeds and columns: file, line, and what is allowed.
#[test]
fn mistakes_in_a_suite_have_their_line() {
    let base = "title = \"s\"\n[[run]]\ntasks = [\"circle.toml\"]\n";
    let grid = |list: &str| format!("title = \"s\"\n[grid]\n{list}\n[[run]]\ntasks = [\"circle.toml\"]\n");
    let cases = [
        (
            grid("\"task.tip.gains.damping_rato\" = [0.7, 1.0]"),
            "suite.toml:3: ",
            "did you mean `damping_ratio`?",
        ),
        (grid("task.tip.gains.damping_ratio = [0.7,\n -1.0]"), "suite.toml:4: ", "-1"),
        (grid("duration_s = 1.0"), "suite.toml:3: ", "expected a list of values"),
        (
            format!("{base}override = [\n\"duration_s=1\",\n\"robot.simulated.true_over_nominal.kq=1\"]\n"),
            "suite.toml:6: ",
            "`kp`",
        ),
        (
            format!("{base}variant = [{{ label = \"a\", override = [\"seed=one\"] }}]\n"),
            "suite.toml:4: ",
            "one",
        ),
        (format!("{base}seeds = {{ from = 3, to = 1 }}\n"), "suite.toml:4: ", "this range is empty"),
        (format!("{base}seeds = {{ from = 3 }}\n"), "suite.toml:4: ", "missing key `to`"),
        (format!("{base}seeds = \"1..3\"\n"), "suite.toml:4: ", "{ from = 1, to = 20 }"),
        (format!("{base}seeds = {{ from = 1, to = 9999999 }}\n"), "suite.toml:4: ", "more than 100000 seeds"),
        (
            format!("columns = [\"position-rms\",\n\"positon-max\"]\n{base}"),
            "suite.toml:2: ",
            "did you mean `position-max`?",
        ),
        (
            format!("columns = [\"position-rms\",\n\"joint-rms\"]\n{base}"),
            "suite.toml:2: no run of this suite has a value for `joint-rms`",
            "joint-tracking",
        ),
        (format!("columns = [\"hand-force\"]\n{base}"), "suite.toml:1: ", "spring"),
    ];
    for (suite, place, words) in cases {
        let folder = circle_folder(&suite);
        bench(folder.path(), &[]).exits(2).says(&[place, words]);
        assert!(!folder.path().join("runs").exists(), "nothing was run");
    }
}

/// A column whose values are only known after the runs.
#[test]
fn column_without_values_fails_after_the_runs() {
    let folder = circle_folder(
        "title = \"s\"\ncolumns = [\"position-rms\", \"force-rms\"]\n[[run]]\ntasks = [\"circle.toml\"]\n",
    );
    bench(folder.path(), &[]).exits(1).says(&["no run has a value for the column `force-rms`"]);
    assert!(folder.path().join("runs/bench-suite/bench.json").exists(), "the results are there");
}

#[test]
fn number_of_runs_and_expected_duration_are_printed() {
    let folder = circle_folder(GRID);
    let ran = bench(folder.path(), &[]).exits(0);
    ran.says(&["8 runs, 4.0 s of simulated time, 2 at a time", "about ", " remaining"]);
}

/// Compared: the CSV and the JSON of a suite, cell by cell, through another reader of CSV.
#[test]
fn csv_has_a_row_per_run_and_a_column_per_metric() {
    let folder = circle_folder(GRID);
    bench(folder.path(), &["--csv", "rows.csv", "--json", "rows.json"]).exits(0);
    let text = read(folder.path().join("rows.csv"));
    let json = read_json(folder.path().join("rows.json"));
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(text.as_bytes());
    let cells = |record: csv::StringRecord| record.iter().map(str::to_owned).collect::<Vec<_>>();
    let lines: Vec<Vec<String>> =
        reader.records().map(|record| cells(record.expect("as many cells as heads"))).collect();
    assert_eq!(lines.len(), 1 + 8);
    let place = |name: &str| {
        lines[0].iter().position(|head| *head == name).unwrap_or_else(|| panic!("{name}: {text}"))
    };
    for (row, line) in json["rows"].as_array().unwrap().iter().zip(&lines[1..]) {
        assert_eq!(row["metrics"]["position_rms_m"].to_string(), line[place("position_rms_m")]);
        assert_eq!(row["timing"]["tick_ns_median"].to_string(), line[place("tick_ns_median")]);
        assert_eq!(row["tasks"]["tip"]["position_max_m"].to_string(), line[place("task.tip.position_max_m")]);
        let joint = &row["joints"]["elbow"]["torque_error_rms_nm"];
        assert_eq!(joint.to_string(), line[place("joint.elbow.torque_error_rms_nm")]);
        assert_eq!(row["seed"].to_string(), line[place("seed")]);
        let set = format!("task.tip.gains.damping_ratio={}", line[place("task.tip.gains.damping_ratio")]);
        assert_eq!(row["overrides"][0], set);
        assert_eq!(row["label"], line[place("label")], "a cell with a comma");
        assert_eq!(line[place("joint_rms_rad")], "", "a missing value is an empty cell");
    }
    let printed = bench(folder.path(), &["--csv", "-"]).exits(0).stdout;
    assert_eq!(printed.lines().next(), text.lines().next());
    bench(folder.path(), &["--csv", "-", "--json", "-"]).exits(2).says(&["cannot both"]);
    fs::write(folder.path().join("notes.csv"), "mine\n").unwrap();
    bench(folder.path(), &["--csv", "notes.csv"]).exits(2).says(&["not a CSV file of results"]);
}

/// Starts the suite, and stops it by a signal as soon as it has completed some runs.
fn cut_off(folder: &Path, options: &[&str], rows: &str, signal: &str) {
    let all = [&["bench", "suite.toml", "--jobs", "1"], options].concat();
    let mut child = command(folder, &all).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let begin = Instant::now();
    let lines = || fs::read_to_string(folder.join(rows)).map_or(0, |text| text.lines().count());
    while lines() < 3 {
        assert!(begin.elapsed() < Duration::from_secs(60), "no rows");
        sleep(Duration::from_millis(5));
    }
    Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
    child.wait().unwrap();
}

/// Compared: the rows of a suite that was killed and continued, and those of one that was not; and how many lines were
/// kept. A line that was cut off in the middle counts as not written.
#[test]
fn killed_suite_is_continued_by_the_same_command() {
    let suite = GRID.replace("to = 2", "to = 8");
    let folder = circle_folder(&suite);
    let rows = folder.path().join("runs/bench-suite/rows.jsonl");
    cut_off(folder.path(), &[], "runs/bench-suite/rows.jsonl", "-KILL");
    assert!(!folder.path().join("runs/bench-suite/bench.json").exists());
    let kept = read(&rows);
    let half = kept.lines().last().unwrap();
    fs::write(&rows, format!("{kept}{}", &half[..half.len() / 2])).unwrap();
    let complete = kept.lines().count() - 1;
    let said = format!("{} runs, ", 32 - complete);
    bench(folder.path(), &[]).exits(0).says(&[&said, &format!("continued: {complete} runs are complete")]);
    let continued = read(&rows);
    for line in kept.lines() {
        assert!(continued.lines().any(|other| other == line), "a complete run was repeated");
    }
    bench(folder.path(), &["--out", "whole"]).exits(0);
    let [a, b] = ["runs/bench-suite", "whole"].map(|name| folder.path().join(name).join("bench.json"));
    assert_eq!(without_timing(a), without_timing(b));
    // A complete suite is not continued: the rules for existing results apply.
    bench(folder.path(), &["--out", "whole"]).exits(2).says(&["already contains a run; use --force"]);
    let again = bench(folder.path(), &[]).exits(0);
    again.says(&["runs/bench-suite.previous", "32 runs, "]);
}

/// A suite that was interrupted prints what it has, and is continued; another suite in its folder is not.
#[test]
fn interrupted_suite_is_continued_unless_it_was_changed() {
    let suite = GRID.replace("to = 2", "to = 8");
    let folder = circle_folder(&suite);
    cut_off(folder.path(), &["--out", "out"], "out/rows.jsonl", "-INT");
    assert!(folder.path().join("out/report.html").exists() && !folder.path().join("out/bench.json").exists());
    fs::write(folder.path().join("suite.toml"), suite.replace("0.9", "0.95")).unwrap();
    bench(folder.path(), &["--out", "out"]).exits(2).says(&["already contains a run; use --force"]);
    fs::write(folder.path().join("suite.toml"), &suite).unwrap();
    bench(folder.path(), &["--out", "out"]).exits(0).says(&["continued: "]);
    let rows = read_json(folder.path().join("out/bench.json"));
    assert!(column(&rows, "interrupted").iter().all(|interrupted| interrupted == false));
    // A task file that the suite names was changed: these are no longer results of this suite.
    let task = folder.path().join("circle.toml");
    fs::write(&task, read(&task).replace("amplitude_m = 0.1", "amplitude_m = 0.11")).unwrap();
    cut_off(folder.path(), &["--out", "out", "--force"], "out/rows.jsonl", "-KILL");
    fs::write(&task, read(&task).replace("amplitude_m = 0.11", "amplitude_m = 0.1")).unwrap();
    bench(folder.path(), &["--out", "out"]).exits(2).says(&["use --force"]);
}

/// Compared: bench.json, rows and logs of merged shards and of the whole suite, byte by byte except for computing times,
/// for several numbers of shards.
#[test]
fn merged_shards_equal_the_whole_suite() {
    let two = "[[run]]\ntasks = [\"other.toml\"]\ngrid = {}\nbackend = \"torque\"\n";
    let folder =
        circle_folder(&GRID.replace("to = 2", "to = 1").replace("[[run]]", &format!("{two}[[run]]")));
    let at = |name: &str| folder.path().join(name);
    fs::copy(at("circle.toml"), at("other.toml")).unwrap();
    bench(folder.path(), &["--out", "whole"]).exits(0);
    for count in [1, 3, 7] {
        for index in 1..=count {
            bench(folder.path(), &["--shard", &format!("{index}/{count}"), "--out", &format!("in-{count}")])
                .exits(0);
        }
        let out = format!("of-{count}");
        opspace(folder.path(), &["merge", &format!("in-{count}"), "--out", &out, "--json", "merged.json"])
            .exits(0);
        for json in [at("merged.json"), at(&out).join("bench.json")] {
            assert_eq!(without_timing(json), without_timing(at("whole/bench.json")), "{count} shards");
        }
        assert_eq!(read(at(&out).join("rows.jsonl")).lines().count(), 1 + 5);
        let files = |name: &str| {
            let mut names: Vec<_> = fs::read_dir(at(name)).unwrap().map(|e| e.unwrap().file_name()).collect();
            names.sort();
            names
        };
        assert_eq!(files(&out), files("whole"));
    }
    let log = |name: &str| opspace_log::Recording::read(at(name).join("circle-position.mcap")).unwrap();
    let (a, b) = (log("whole"), log("of-3"));
    let q = |log: &opspace_log::Recording| {
        log.channel("tick").unwrap().signal("q").unwrap().rows().map(<[f64]>::to_vec).collect::<Vec<_>>()
    };
    assert_eq!(q(&a), q(&b), "the log of the first run of the task");
    // Complete: nothing is run again.
    bench(folder.path(), &["--shard", "2/3", "--out", "in-3"]).exits(0).says(&["all 2 runs are complete"]);
}

/// Missing shards and rows are listed; shards of another suite are refused, as is a folder that is no shard.
#[test]
fn merge_lists_missing_runs_and_refuses_other_suites() {
    let folder = circle_folder(&GRID.replace("to = 2", "to = 1"));
    let at = |name: &str| folder.path().join(name);
    for shard in ["1/3", "3/3"] {
        bench(folder.path(), &["--shard", shard, "--out", "all"]).exits(0);
    }
    let merged = opspace(folder.path(), &["merge", "all", "--json", "part.json"]).exits(3);
    merged.says(&["missing: run 2 (shard 2/3)", "1 of 4 runs are missing"]);
    assert_eq!(read_json(at("part.json"))["missing"], serde_json::json!([2]));
    fs::write(at("suite.toml"), read(at("suite.toml")).replace("0.9", "0.95")).unwrap();
    bench(folder.path(), &["--shard", "2/3", "--out", "all"]).exits(0);
    let mixed = ["merge", "all"];
    opspace(folder.path(), &mixed)
        .exits(2)
        .says(&["shard-1-of-3 and all/shard-2-of-3 are not shards of one suite"]);
    let rows = at("all/shard-2-of-3/rows.jsonl");
    let text =
        read(at("all/shard-3-of-3/rows.jsonl")).replace("\"opspace_version\":\"", "\"opspace_version\":\"9.");
    fs::write(rows, text).unwrap();
    opspace(folder.path(), &mixed).exits(2).says(&["are results of opspace"]);
    fs::create_dir(at("empty")).unwrap();
    opspace(folder.path(), &["merge", "empty"]).exits(2).says(&["has no rows.jsonl"]);
    opspace(folder.path(), &["merge", "nowhere"]).exits(2).says(&["nowhere: cannot be read"]);
    fs::write(at("empty/rows.jsonl"), "{}\n").unwrap();
    opspace(folder.path(), &["merge", "empty"]).exits(2).says(&["is not a file of rows"]);
}

/// Default folders: parts of a changed suite are moved aside, and merged without the earlier ones.
#[test]
fn shards_of_a_changed_suite_take_the_place_of_earlier_ones() {
    let folder = circle_folder(&GRID.replace("to = 2", "to = 1"));
    let suite = folder.path().join("suite.toml");
    let all = || {
        for shard in ["1/2", "2/2"] {
            bench(folder.path(), &["--shard", shard]).exits(0);
        }
    };
    all();
    fs::write(&suite, read(&suite).replace("0.9", "0.95")).unwrap();
    all();
    assert!(folder.path().join("runs/bench-suite-shards/shard-2-of-2.previous/bench.json").exists());
    opspace(folder.path(), &["merge", "runs/bench-suite-shards"]).exits(0);
    let rows = read_json(folder.path().join("runs/bench-suite/bench.json"));
    assert_eq!(rows["rows"][0]["overrides"][1], "robot.simulated.true_over_nominal.inertia=0.95");
}

/// A part that runs differently on another machine is not merged.
#[test]
fn merge_refuses_two_results_of_one_run() {
    let folder = circle_folder(&GRID.replace("to = 2", "to = 1"));
    let at = |name: &str| folder.path().join(name);
    bench(folder.path(), &["--shard", "1/4", "--out", "a"]).exits(0);
    bench(folder.path(), &["--shard", "1/2", "--out", "b"]).exits(0);
    let all = ["merge", "a", "b", "--out", "both"];
    opspace(folder.path(), &all).exits(3).says(&["2 of 4 runs are missing"]);
    let rows = at("b/shard-1-of-2/rows.jsonl");
    let other = read(&rows).replacen("\"position_rms_m\":0", "\"position_rms_m\":1", 1);
    fs::write(rows, other).unwrap();
    opspace(folder.path(), &["merge", "a", "b", "--out", "more"]).exits(1).says(&["run 1 (circle) differs"]);
}

/// Two processes on one part: one waits for the other, then finds the part complete.
#[test]
fn two_processes_on_one_shard_give_one_result() {
    let folder = circle_folder(&GRID.replace("to = 2", "to = 4"));
    let arguments = ["bench", "suite.toml", "--jobs", "1", "--shard", "1/1", "--out", "all"];
    let spawn =
        || command(folder.path(), &arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let outputs = [spawn(), spawn()].map(|child| child.wait_with_output().unwrap());
    let said: String = outputs.iter().map(|output| String::from_utf8_lossy(&output.stderr)).collect();
    assert!(outputs.iter().all(|output| output.status.code() == Some(0)), "{said}");
    assert_eq!(said.matches("all 16 runs are complete").count(), 1, "{said}");
    assert_eq!(read(folder.path().join("all/shard-1-of-1/rows.jsonl")).lines().count(), 17);
}

/// The part of a Slurm array and of a Kubernetes job; neither, and one that does not determine the part.
#[test]
fn shard_is_read_from_the_batch_system() {
    let folder = circle_folder(&GRID.replace("to = 2", "to = 1"));
    let with = |env: &[(&str, &str)], shard: &str| {
        let mut command = command(folder.path(), &["bench", "suite.toml", "--shard", shard, "--out", "all"]);
        for name in ["ID", "MIN", "MAX", "STEP", "COUNT"] {
            command.env_remove(format!("SLURM_ARRAY_TASK_{name}"));
        }
        let output = command.env_remove("JOB_COMPLETION_INDEX").envs(env.iter().copied()).output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let slurm = [("ID", "4"), ("MIN", "2"), ("MAX", "6"), ("STEP", "2"), ("COUNT", "3")];
    let slurm = slurm.map(|(name, value)| (format!("SLURM_ARRAY_TASK_{name}"), value));
    let slurm: Vec<(&str, &str)> = slurm.iter().map(|(name, value)| (name.as_str(), *value)).collect();
    assert_eq!(with(&slurm, "auto").0, Some(0));
    assert!(folder.path().join("all/shard-2-of-3/bench.json").exists());
    assert_eq!(with(&[("JOB_COMPLETION_INDEX", "0")], "auto/3").0, Some(0));
    assert!(folder.path().join("all/shard-1-of-3/bench.json").exists());
    for (env, shard, words) in [
        (&[][..], "auto", "neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX"),
        (&[("JOB_COMPLETION_INDEX", "0")], "auto", "auto/N"),
        (&[("JOB_COMPLETION_INDEX", "3")], "auto/3", "from 0 to 2"),
        (&[], "4/3", "expected a part such as 1/8"),
    ] {
        let (code, said) = with(env, shard);
        assert!(code == Some(2) && said.contains(words), "{said}");
    }
}

/// Checks equal results, results that are worse and better, a changed suite, and files that are no baseline.
#[test]
fn baseline_finds_what_is_worse() {
    let suite = "title = \"s\"\n[[run]]\ntasks = [\"circle.toml\"]\nseeds = { from = 1, to = 3 }\n";
    let folder = circle_folder(suite);
    let at = |name: &str| folder.path().join(name);
    bench(folder.path(), &["--json", "old.json"]).exits(0);
    let same = bench(folder.path(), &["--baseline", "old.json"]).exits(0).stdout;
    assert!(same.contains("0 worse, 0 better"), "{same}");
    let edited = |factor: f64| {
        let mut old = read_json(at("old.json"));
        for row in old["rows"].as_array_mut().unwrap() {
            let error = row["metrics"]["position_rms_m"].as_f64().unwrap();
            row["metrics"]["position_rms_m"] = Value::from(factor * error);
        }
        fs::write(at("edited.json"), old.to_string()).unwrap();
    };
    edited(0.9);
    let worse =
        bench(folder.path(), &["--baseline", "edited.json", "--json", "new.json", "-v"]).exits(1).stdout;
    assert!(worse.contains("1 worse, 0 better") && worse.contains("position_rms_m"), "{worse}");
    assert!(worse.contains("Student's t") && worse.contains("more than 1 %"), "{worse}");
    let comparison = read_json(at("new.json"))["comparison"].clone();
    let metrics = comparison["metrics"].as_array().unwrap();
    let found = metrics.iter().find(|metric| metric["verdict"] == "worse").unwrap();
    assert_eq!((&found["metric"], &found["pairs"]), (&Value::from("position_rms_m"), &Value::from(3)));
    edited(1.1);
    bench(folder.path(), &["--baseline", "edited.json"]).exits(0);
    // A value that the baseline has and the new results lack.
    let mut old = read_json(at("old.json"));
    old["rows"][1]["metrics"]["joint_rms_rad"] = Value::from(0.1);
    fs::write(at("edited.json"), old.to_string()).unwrap();
    bench(folder.path(), &["--baseline", "edited.json"])
        .exits(1)
        .says(&["has no value any more: circle", "joint_rms_rad"]);
    // One seed more than the baseline has, and one less.
    fs::write(at("suite.toml"), suite.replace("from = 1, to = 3", "from = 2, to = 4")).unwrap();
    bench(folder.path(), &["--baseline", "old.json"]).exits(0).says(&[
        "only in the baseline: circle on planar-2-link",
        "seed 1",
        "not in the baseline: ",
        "seed 4",
    ]);
    fs::write(at("suite.toml"), suite.replace("from = 1, to = 3", "from = 7, to = 8")).unwrap();
    bench(folder.path(), &["--baseline", "old.json"]).exits(2).says(&["old.json: has none of the runs"]);
    fs::write(at("suite.toml"), suite).unwrap();
    // The results in the default folder are moved aside, those in a chosen one would be overwritten.
    bench(folder.path(), &["--baseline", "runs/bench-suite/bench.json"]).exits(0);
    bench(folder.path(), &["--out", "out"]).exits(0);
    let own = ["--baseline", "out/bench.json", "--out", "out", "--force"];
    bench(folder.path(), &own).exits(2).says(&["is an input"]);
    fs::write(at("none.json"), "{}").unwrap();
    bench(folder.path(), &["--baseline", "none.json"]).exits(2).says(&["is not a file of `opspace bench`"]);
    bench(folder.path(), &["--baseline", "missing.json"]).exits(2).says(&["there is no such file"]);
}
