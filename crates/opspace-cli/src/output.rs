//! Output folder. Recorded results are only overwritten on request.

use crate::cli::{JsonArgs, OutputArgs};
use crate::console::{Console, Exit, Failure, print};
use opspace_experiment::Source;
pub use opspace_experiment::run::folder::{LOG, REPORT, SUMMARY};
use opspace_log::{LogError, Recording};
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};

/// Name of the subfolder of a run for the motion to the start.
pub const MOVE_TO_START: &str = "move-to-start";
/// File name of the results of a suite.
pub const ROWS: &str = "bench.json";
/// File name of the results of an identification.
pub const IDENTIFICATION: &str = "identification.json";
/// File name of the identified keys of a robot file.
pub const SERVO_FILE: &str = "servo.toml";
/// File name of a complete robot file with the identified keys.
pub const ROBOT_FILE: &str = "robot.toml";

/// Creates the folder for results. An existing default folder with results is renamed; a folder given by the user is
/// only reused with `--force`.
pub fn prepare(args: &OutputArgs, default: &Path, console: Console) -> Result<PathBuf, Failure> {
    let folder = args.out.clone().unwrap_or_else(|| default.to_owned());
    if holds_results(&folder) {
        if args.out.is_none() {
            set_aside(&folder, console)?;
        } else if args.force {
            clear(&folder)?;
        } else {
            let text = format!("{}: already contains a run; use --force to replace it", folder.display());
            return Err(Failure::Other(text, Exit::Bad));
        }
    }
    fs::create_dir_all(&folder).map_err(|e| Failure::io("cannot be created", &folder, &e))?;
    Ok(folder)
}

fn holds_results(folder: &Path) -> bool {
    let named = [LOG, SUMMARY, ROWS, IDENTIFICATION].iter().any(|name| folder.join(name).exists());
    named || folder.join(MOVE_TO_START).join(LOG).exists()
}

/// Renames a folder to NAME.previous, or to NAME.previous-2 and so on if this name is in use.
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

/// Removes only the files that a run, a suite or an identification has written.
fn clear(folder: &Path) -> Result<(), Failure> {
    let motion = folder.join(MOVE_TO_START);
    if holds_results(&motion) {
        clear(&motion)?;
    }
    let identified = folder.join(IDENTIFICATION).exists();
    let logs = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let ours = logs.filter(|path| {
        let named = |names: &[&str]| names.iter().any(|name| path.ends_with(name));
        // robot.toml is a result only if the folder contains an identification.
        named(&[LOG, REPORT, SUMMARY, ROWS, IDENTIFICATION])
            || identified && named(&[SERVO_FILE, ROBOT_FILE])
            || path.extension().is_some_and(|e| e == "mcap")
    });
    for path in ours {
        fs::remove_file(&path).map_err(|e| Failure::io("cannot be replaced", &path, &e))?;
    }
    Ok(())
}

/// Writes a result file.
pub fn write(path: &Path, text: &str) -> Result<(), Failure> {
    fs::write(path, text).map_err(|e| Failure::io("cannot be written", path, &e))
}

impl JsonArgs {
    /// Writes the JSON to the file given by `--json`, and prints the text; with `--json -`, prints only the JSON.
    pub fn print(&self, json: impl FnOnce() -> String, text: impl FnOnce() -> String) -> Result<(), Failure> {
        match &self.json {
            Some(path) if path == Path::new("-") => return print(&json()),
            Some(path) => write(path, &json())?,
            None => {}
        }
        print(&text())
    }
}

/// Formats JSON for human readers.
pub fn pretty(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}

/// Reads the log at a path; for a folder, the `run.mcap` in it.
pub fn read_log(path: &Path) -> Result<(PathBuf, Recording), Failure> {
    let path = if path.is_dir() { path.join(LOG) } else { path.to_owned() };
    match Recording::read(&path) {
        Ok(recording) => Ok((path, recording)),
        Err(error) => match Source::read(&path) {
            // The file cannot be opened: use the same message as for any other file.
            Err(unread) if matches!(error, LogError::Read { .. }) => Err(unread.into()),
            _ => Err(Failure::Other(format!("{}: {error}", path.display()), Exit::Bad)),
        },
    }
}
