//! Suite files.

use crate::edits::{apply_to_text, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::messages::check_error;
use crate::{CORPUS, files, root, texts};
use opspace_experiment::Files;
use opspace_suite::Suite;
use std::fs;
use std::path::Path;

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 256 << 20;

/// Largest number of runs of a suite that is read: each is an experiment of its own.
const MAX_RUNS: usize = 200;

/// An error names a file beside the suite. An accepted suite has runs with robots and tasks, and the same fingerprint
/// when it is read again.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn suite() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = copy_inputs(folder.path());
    let seeds = texts(CORPUS, ".suite.toml");
    let target = Target::new("suite", MOST_BYTES);
    // The edge values have a path that is not relative.
    let names = |path: &str| Path::new(path).starts_with(folder.path()) || path.starts_with("/dev/");
    for_each_input(edited(seeds.len()), 100, |(seed, edits)| {
        let text = apply_to_text(&seeds, *seed, edits);
        if runs(&text) > MAX_RUNS {
            return;
        }
        fs::write(&file, &text).expect("a temporary file");
        target.check(text.as_bytes(), edits.is_empty(), || match Suite::load(Files::Disk, &file) {
            Ok(suite) => {
                check_suite(&suite, &file);
                true
            }
            Err(error) => {
                let path = error.path().to_owned();
                // A file that a setting names and that is not there has a path of its own.
                if !error.message().contains("there is no such file") {
                    check_error(&error, &[if names(&path) { &path } else { "--set" }]);
                }
                false
            }
        });
    });
}

fn check_suite(suite: &Suite, file: &Path) {
    assert!((1..=MAX_RUNS).contains(&suite.runs.len()));
    assert!(suite.of_robots().all(|experiment| experiment.robot().model.n() > 0));
    let fingerprint = suite.fingerprint();
    assert!(fingerprint.len() == 64 && fingerprint.bytes().all(|byte| byte.is_ascii_hexdigit()));
    let again = Suite::load(Files::Disk, file).expect("the same suite");
    assert_eq!(again.fingerprint(), fingerprint);
    assert_eq!(again.runs.len(), suite.runs.len());
}

/// Copies all robots and tasks to a folder, and returns the path for the suite in it.
fn copy_inputs(folder: &Path) -> std::path::PathBuf {
    let mut paths = [files("tasks", ".toml"), files("tasks/paths", ".csv")].concat();
    for robot in crate::robot::ROBOTS {
        paths.extend([format!("robots/{robot}/robot.toml"), format!("robots/{robot}/{robot}.urdf")]);
    }
    for path in paths {
        let to = folder.join(&path);
        fs::create_dir_all(to.parent().expect("a folder")).expect("a folder");
        fs::copy(root(&path), to).expect("a copy");
    }
    let suites = folder.join("tasks/suites");
    fs::create_dir_all(&suites).expect("a folder");
    suites.join("fuzz.toml")
}

/// Number of runs that a suite may have; 0 for what is not TOML.
fn runs(text: &str) -> usize {
    let Ok(file) = text.parse::<toml::Table>() else { return 0 };
    let grid = |table: &toml::Table| {
        fn points(value: &toml::Value) -> usize {
            match value {
                toml::Value::Table(table) => table.values().map(points).fold(1, usize::saturating_mul),
                toml::Value::Array(values) => values.len().max(1),
                _ => 1,
            }
        }
        table.get("grid").map_or(1, points)
    };
    let count = |table: &toml::Table, key: &str| {
        table.get(key).and_then(toml::Value::as_array).map_or(1, |list| list.len().max(1))
    };
    let entries = file.get("run").and_then(toml::Value::as_array).into_iter().flatten();
    let of_run = |run: &toml::Table| {
        let range = |seeds: &toml::Table| {
            let end = |key: &str| seeds.get(key).and_then(toml::Value::as_integer).unwrap_or(0);
            usize::try_from(end("to").saturating_sub(end("from"))).unwrap_or(0).saturating_add(1)
        };
        let seeds = run.get("seeds").and_then(toml::Value::as_table).map_or(count(run, "seeds"), range);
        let profiles = count(run, "profiles").max(count(&file, "profiles"));
        let points = grid(run).max(grid(&file));
        [count(run, "tasks"), count(run, "variant"), profiles, seeds, points]
            .into_iter()
            .fold(1, usize::saturating_mul)
    };
    entries.filter_map(toml::Value::as_table).map(of_run).fold(0, usize::saturating_add)
}
