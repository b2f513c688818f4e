//! Output folder. Recorded results are only overwritten on request.

use crate::cli::JsonArgs;
use crate::console::{Exit, Failure, print, print_exactly};
use opspace_experiment::Source;
use opspace_experiment::run::result_files::{LOG, write_file};
use opspace_experiment::run::robot_logs::robot_logs;
use opspace_log::{LogError, LogFile, Recording};
use opspace_model::files::open_file;
use serde::Serialize;
use serde::de::IgnoredAny;
use std::io;
use std::path::{Path, PathBuf};

/// Writes a file of results into a folder of results.
pub fn write(path: &Path, text: &str) -> Result<(), Failure> {
    write_file(path, text).map_err(|e| Failure::io("cannot be written", path, &e))
}

/// Writes a file that the user named. An existing one is replaced only if it has the same format.
pub fn write_named(path: &Path, text: &str, format: Format) -> Result<(), Failure> {
    if path.is_file() && !format.is_that_of(path) {
        let text = format!(
            "{}: exists and is not {}; choose another file for the output",
            path.display(),
            format.name()
        );
        return Err(Failure::Other(text, Exit::Bad));
    }
    write(path, text)
}

/// Format of a file of results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Json,
    JsonLines,
    Html,
    Csv,
    /// Rows of a channel of a log.
    LogCsv,
}

impl Format {
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "a JSON file",
            Self::JsonLines => "a file of JSON lines",
            Self::Html => "a web page",
            Self::Csv => "a CSV file of results",
            Self::LogCsv => "a CSV file of a log",
        }
    }

    /// True if an existing file has this format, or is empty.
    pub fn is_that_of(self, path: &Path) -> bool {
        let Ok(text) = open_file(path).and_then(io::read_to_string) else { return false };
        let is_json = |text: &str| serde_json::from_str::<IgnoredAny>(text).is_ok();
        text.trim().is_empty()
            || match self {
                Self::Json => is_json(&text),
                Self::JsonLines => text.lines().all(|line| line.trim().is_empty() || is_json(line)),
                Self::Html => text.trim_start().to_ascii_lowercase().starts_with("<!doctype html"),
                Self::Csv => {
                    let of_suite = ["task,robot,", "experiment,label,seed,"];
                    of_suite.iter().any(|first| text.starts_with(first))
                }
                Self::LogCsv => text.starts_with("time_s"),
            }
    }
}

impl JsonArgs {
    /// File for the JSON; `None` if there is none or the JSON goes to stdout.
    pub fn path(&self) -> Option<&Path> {
        self.json.as_deref().filter(|path| *path != Path::new("-"))
    }

    /// Writes the results where `--json` requests them, and prints them as text unless the JSON is printed instead.
    pub fn print(&self, json: impl FnOnce() -> String, text: impl FnOnce() -> String) -> Result<(), Failure> {
        match (self.path(), &self.json) {
            (Some(path), _) => write_named(path, &json(), Format::Json)?,
            (None, Some(_)) => return print_exactly(&json()),
            (None, None) => {}
        }
        print(&text())
    }
}

/// Formats JSON for human readers.
pub fn pretty(value: &impl Serialize) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}

/// Path of the log that a path denotes: a folder stands for the `run.mcap` in it.
pub fn log_path(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(LOG) } else { path.to_owned() }
}

/// Logs of the robots if a path denotes the folder of an experiment with several robots, otherwise none.
pub fn logs_of_experiment(path: &Path) -> Vec<PathBuf> {
    if log_path(path).exists() { Vec::new() } else { robot_logs(path) }
}

/// Logs of the robots if a path denotes the folder of several: of an experiment, or of robots that ran side by side. Otherwise none.
pub fn logs_of_robots(path: &Path) -> Vec<PathBuf> {
    let mut logs = logs_of_experiment(path);
    if logs.is_empty() && path.is_dir() && !log_path(path).exists() {
        let folders = std::fs::read_dir(path).into_iter().flatten().flatten();
        logs.extend(folders.map(|folder| folder.path().join(LOG)).filter(|log| log.is_file()));
        logs.sort();
    }
    logs
}

/// Logs that a path denotes: one, or those of several robots.
pub fn logs_of_run(path: &Path) -> Vec<PathBuf> {
    let logs = logs_of_robots(path);
    if logs.is_empty() { vec![log_path(path)] } else { logs }
}

/// Name of the folder of a log: that of its robot among several.
pub fn folder_name(log: &Path) -> String {
    log.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy().into_owned()
}

/// Reads the log that a path denotes, as [`log_path`] does.
pub fn read_log(path: &Path) -> Result<(PathBuf, Recording), Failure> {
    let path = log_path(path);
    let recording = Recording::read(&path).map_err(|error| unreadable(&path, &error))?;
    Ok((path, recording))
}

/// Opens the log that a path denotes, as [`log_path`] does, to read it in segments.
pub fn open_log(path: &Path) -> Result<(PathBuf, LogFile), Failure> {
    let path = log_path(path);
    let log = LogFile::open(&path).map_err(|error| unreadable(&path, &error))?;
    Ok((path, log))
}

/// Error about a log that cannot be read.
pub fn unreadable(path: &Path, error: &LogError) -> Failure {
    match Source::read(path) {
        // The file cannot be opened: use the same message as for any other file.
        Err(unread) if matches!(error, LogError::Read { .. }) => unread.into(),
        _ => Failure::Other(format!("{}: {error}", path.display()), Exit::Bad),
    }
}
