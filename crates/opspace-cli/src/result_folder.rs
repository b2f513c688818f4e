//! Folder of results. Recorded results are never overwritten unless requested, and nothing else ever is.

use crate::cli::OutputArgs;
use crate::console::{Console, Exit, Failure};
use crate::outputs::check_outputs;
use opspace_experiment::run::result_files::{LOG, REPORT, ResultFolder, SUMMARY};
use opspace_experiment::run::robot_logs::robot_logs;
use opspace_log::LogFile;
use opspace_model::files::open_file;
use opspace_suite::suite_rows::{SUITE_ROWS, SuiteRows};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Name of the folder, within that of a run, for the motion to the start.
pub const MOVE_TO_START: &str = "move-to-start";
/// File name of a suite's rows.
pub const ROWS: &str = "bench.json";
/// Key of the names of a suite's logs in its rows.
pub const LOGS: &str = "logs";
/// File name of an identification's numbers.
pub const IDENTIFICATION: &str = "identification.json";
/// File name of a robot file's identified keys.
pub const SERVO_FILE: &str = "servo.toml";
/// File name of a robot file with the identified keys.
pub const ROBOT_FILE: &str = "robot.toml";

/// Creates and locks the folder for results. An existing default folder with results is moved aside; one given by the
/// user is only reused with `--force`, which removes the results of an earlier command and nothing else.
///
/// `files` are the names of the files that the command will write, `inputs` the files that it reads.
pub fn prepare(
    args: &OutputArgs,
    default: &Path,
    files: &[String],
    inputs: &[PathBuf],
    console: Console,
) -> Result<ResultFolder, Failure> {
    let path = args.out.clone().unwrap_or_else(|| default.to_owned());
    let mut outputs: Vec<PathBuf> = files.iter().map(|name| path.join(name)).collect();
    outputs.extend(args.json.path().map(Path::to_owned));
    check_outputs(inputs, &outputs)?;
    empty(ResultFolder::open(&path)?, args.out.is_some(), args.force, files, console)
}

/// Makes a locked folder ready for new results, as [`prepare`] does; `chosen` is true for a folder that the user named.
pub fn empty(
    folder: ResultFolder,
    chosen: bool,
    force: bool,
    files: &[String],
    console: Console,
) -> Result<ResultFolder, Failure> {
    let path = folder.path().to_owned();
    if !holds_results(&path) && robots_logs(&path, files).is_empty() {
        refuse_foreign(&path, files)?;
        return Ok(folder);
    }
    if !chosen {
        set_aside(&path, console)?;
        // The lock stays with the folder that was moved: the new one has its own.
        return Ok(ResultFolder::open(&path)?);
    }
    if !force {
        let text = format!("{}: already contains a run; use --force to replace it", path.display());
        return Err(Failure::Other(text, Exit::Bad));
    }
    clear(&path)?;
    robots_logs(&path, files).iter().try_for_each(|log| clear_robot(log))?;
    refuse_foreign(&path, files)?;
    Ok(folder)
}

/// Refuses a folder in which a file that no earlier command wrote has the name of a result.
fn refuse_foreign(folder: &Path, files: &[String]) -> Result<(), Failure> {
    let Some(name) = files.iter().find(|name| folder.join(name).exists()) else { return Ok(()) };
    let text = format!(
        "{}: already exists, and is not a result of an earlier run; choose another folder with --out",
        folder.join(name).display()
    );
    Err(Failure::Other(text, Exit::Bad))
}

fn holds_results(folder: &Path) -> bool {
    let named =
        [LOG, SUMMARY, ROWS, SUITE_ROWS, IDENTIFICATION].iter().any(|name| folder.join(name).exists());
    named || folder.join(MOVE_TO_START).join(LOG).exists() || !robot_logs(folder).is_empty()
}

/// Logs among the files of a run of several robots, each in the folder of its robot: those of a run that was cut off, which has no summary
/// that names its robots.
fn robots_logs(folder: &Path, files: &[String]) -> Vec<PathBuf> {
    let of_robots = files.iter().filter(|name| {
        let name = Path::new(name);
        name.file_name() == Some(LOG.as_ref()) && name != Path::new(LOG)
    });
    let logs = of_robots.map(|name| folder.join(name)).filter(|log| log.is_file());
    logs.filter(|log| LogFile::open(log).is_ok()).collect()
}

/// Moves a folder to NAME.previous, or NAME.previous-2 and so on if that is taken.
fn set_aside(folder: &Path, console: Console) -> Result<(), Failure> {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let free = (1..)
        .map(|k| match k {
            1 => folder.with_file_name(format!("{name}.previous")),
            k => folder.with_file_name(format!("{name}.previous-{k}")),
        })
        .find(|path| !path.exists());
    let Some(aside) = free else { return Ok(()) };
    fs::rename(folder, &aside).map_err(|e| Failure::io("cannot be renamed", folder, &e))?;
    console.note(&format!("moved the previous run to {}", aside.display()));
    Ok(())
}

/// Removes the files that a run, a suite or an identification wrote, and nothing else.
fn clear(folder: &Path) -> Result<(), Failure> {
    let motion = folder.join(MOVE_TO_START);
    if holds_results(&motion) {
        clear(&motion)?;
    }
    for log in robot_logs(folder).into_iter().chain(logs_of_summary(folder)).filter(|log| log.is_file()) {
        clear_robot(&log)?;
    }
    let mut ours = vec![LOG, REPORT, SUMMARY, ROWS, SUITE_ROWS, IDENTIFICATION];
    // A robot file is ours only beside an identification.
    if folder.join(IDENTIFICATION).exists() {
        ours.extend([SERVO_FILE, ROBOT_FILE]);
    }
    let mut logs = logs_of_suite(&folder.join(ROWS));
    // A suite that was cut off has no other list of its logs.
    logs.extend(logs_of_rows(folder));
    for run in logs.iter().map(|name| folder.join(name)).filter(|path| path.is_dir()) {
        clear_run_of_robots(&run)?;
    }
    logs.retain(|name| !folder.join(name).is_dir());
    ours.into_iter().chain(logs.iter().map(String::as_str)).try_for_each(|name| remove(&folder.join(name)))
}

/// Logs of the robots that the summary in a folder names: of several robots, each has a folder.
fn logs_of_summary(folder: &Path) -> Vec<PathBuf> {
    let text = open_file(&folder.join(SUMMARY)).and_then(io::read_to_string).ok();
    let read = text.and_then(|text| serde_json::from_str::<Value>(&text).ok());
    let names = read.as_ref().and_then(|summary| summary["robots"].as_object()).into_iter().flatten();
    // A name with a folder in it is none of a robot.
    let names = names.map(|(name, _)| name).filter(|name| Path::new(name).file_name() == Some(name.as_ref()));
    names.map(|name| folder.join(name).join(LOG)).collect()
}

/// Removes the log of a robot of an experiment, and the other results beside it; their folder too if it is then empty.
fn clear_robot(log: &Path) -> Result<(), Failure> {
    let folder = log.parent().unwrap_or(Path::new(""));
    let _lock = ResultFolder::open(folder)?;
    [LOG, REPORT, SUMMARY].into_iter().try_for_each(|name| remove(&folder.join(name)))?;
    // A folder with other files in it remains.
    let _ = fs::remove_dir(folder);
    Ok(())
}

fn remove(path: &Path) -> Result<(), Failure> {
    if path.exists() {
        fs::remove_file(path).map_err(|e| Failure::io("cannot be replaced", path, &e))?;
    }
    Ok(())
}

/// Removes the files of a run of several robots, and the folders that are then empty.
pub fn clear_run_of_robots(folder: &Path) -> Result<(), Failure> {
    if folder.is_dir() {
        clear(folder)?;
        // A folder with anything else in it remains.
        let _ = fs::remove_dir(folder);
    }
    Ok(())
}

fn logs_of_rows(folder: &Path) -> Vec<String> {
    let rows = SuiteRows::read(folder).into_iter().flat_map(|rows| rows.rows.into_values());
    rows.filter_map(|row| row.log).collect()
}

/// Names of the logs beside the rows of a suite; none if the rows cannot be read.
fn logs_of_suite(rows: &Path) -> Vec<String> {
    let text = open_file(rows).and_then(io::read_to_string).ok();
    let read = text.and_then(|text| serde_json::from_str::<Value>(&text).ok());
    let names = read.as_ref().and_then(|rows| rows[LOGS].as_array()).into_iter().flatten();
    // A name with a folder in it is none that a suite wrote.
    let names =
        names.filter_map(Value::as_str).filter(|name| Path::new(name).file_name() == Some(name.as_ref()));
    names.map(str::to_owned).collect()
}
