//! One of the compared builds: a program, and the checkout with the files that it runs.

use crate::entries::{Entry, Item, Kind, NOT_COMPARED};
use crate::shipped::{Shipped, without_paths};
use crate::suites::Suite;
use crate::{baseline, hashes, keys};
use opspace_log::Recording;
use serde_json::Value;
use std::ffi::OsStr;
use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Place of what concerns a suite as a whole.
const WHOLE: &str = "(suite)";

/// Suites that use what exists only for comparisons.
const COMPARISONS: [&str; 1] = ["singularity.toml"];

/// A build.
#[derive(Clone, Debug)]
pub struct Side {
    program: PathBuf,
    /// Program for the suites of [`COMPARISONS`], if it is another one.
    comparisons: Option<PathBuf>,
    /// Folder with the files.
    pub checkout: PathBuf,
    /// Settings of every run.
    settings: Vec<String>,
}

/// Log of a robot of a run; an error if there is none, or an incomplete one.
#[derive(Debug)]
pub struct Log {
    /// Name of the robot, if the run has several.
    pub robot: Option<String>,
    /// The log.
    pub recording: Result<Recording, String>,
}

impl Side {
    /// Creates a build from a program and a checkout; `duration_s` replaces the durations of the tasks, s.
    ///
    /// # Errors
    /// A program or checkout that does not exist.
    pub fn new(program: &Path, checkout: &Path, duration_s: Option<f64>) -> Result<Self, String> {
        let absolute = |path: &Path| path.canonicalize().map_err(|e| error_text(path, &e));
        // A run that ends before it has settled is refused.
        let settings =
            duration_s.map(|s| vec![format!("duration_s={s:?}"), format!("settle_s={:?}", 0.25 * s)]);
        let settings = settings.unwrap_or_default();
        Ok(Self { program: absolute(program)?, comparisons: None, checkout: absolute(checkout)?, settings })
    }

    /// Returns the build with another program for the suites that use what exists only for comparisons.
    ///
    /// # Errors
    /// A program that does not exist.
    pub fn with_comparisons(self, program: Option<&Path>) -> Result<Self, String> {
        let absolute = |path: &Path| path.canonicalize().map_err(|e| error_text(path, &e));
        Ok(Self { comparisons: program.map(absolute).transpose()?, ..self })
    }

    /// Reads a suite as single runs.
    ///
    /// # Errors
    /// A file that is no suite.
    pub fn suite(&self, file: &Shipped) -> Result<Suite, String> {
        let path = self.checkout.join(&file.path);
        let text = fs::read_to_string(&path).map_err(|e| error_text(&path, &e))?;
        Suite::parse(&text).map_err(|e| error_text(&path, &e))
    }

    /// Executes the runs of a suite in an empty folder, several at a time, and passes each with its logs to `each`.
    ///
    /// # Errors
    /// A program that cannot be started, or files that cannot be written.
    pub fn run_suite(
        &self,
        file: &Shipped,
        suite: &Suite,
        jobs: usize,
        folder: &Path,
        each: &mut dyn FnMut(Item, Vec<Log>),
    ) -> Result<(), String> {
        // The name of a suite is in its results.
        let path = folder.join(file.path.file_name().unwrap_or_default());
        let out = folder.join("out");
        suite.write(&path, &self.checkout, &file.path, &self.settings)?;
        let jobs = jobs.to_string();
        let output = self.run_for(
            file,
            [
                OsStr::new("--quiet"),
                "bench".as_ref(),
                path.as_ref(),
                "--jobs".as_ref(),
                jobs.as_ref(),
                "--out".as_ref(),
                out.as_ref(),
            ],
        )?;
        let mut bench = read_json(&out.join("bench.json")).unwrap_or_default();
        let logs = logs_of_rows(&out.join("rows.jsonl"));
        for (number, run) in suite.runs.iter().enumerate() {
            let entries = bench["rows"].get(number).map(|row| keys::of("", row)).unwrap_or_default();
            let item = Item { place: run.place.clone(), spelling: run.spelling.clone(), entries };
            let log = logs.iter().find(|(of, _)| *of == number + 1).map(|(_, name)| out.join(name));
            each(item, log.as_deref().map(read_logs).unwrap_or_default());
            // Not needed any more: the comparison with a baseline would draw all figures again.
            log.iter().try_for_each(|log| remove(log))?;
        }
        let mut entries = [facts(&output), baseline::comparison(self, &bench, &out)?].concat();
        if let Some(bench) = bench.as_object_mut() {
            bench.remove("rows");
        }
        entries.extend(keys::of("bench.json", &bench));
        each(Item { place: WHOLE.to_owned(), spelling: file.name.clone(), entries }, Vec::new());
        Ok(())
    }

    /// Executes a task, or an experiment with several robots; the folder must not exist.
    ///
    /// # Errors
    /// A program that cannot be started.
    pub fn run_file(&self, file: &Shipped, folder: &Path) -> Result<(Item, Vec<Log>), String> {
        let mut arguments =
            [OsStr::new("--quiet"), "run".as_ref(), file.path.as_os_str(), "--out".as_ref(), folder.as_ref()]
                .to_vec();
        arguments.extend(self.settings.iter().flat_map(|setting| [OsStr::new("--set"), setting.as_ref()]));
        let output = self.run_for(file, arguments)?;
        let summary = read_json(&folder.join("summary.json"));
        let entries =
            [facts(&output), summary.map(|summary| keys::of("", &summary)).unwrap_or_default()].concat();
        let item = Item { place: file.name.clone(), spelling: "alone".to_owned(), entries };
        Ok((item, read_logs(folder)))
    }

    /// Checks a file.
    ///
    /// # Errors
    /// A program that cannot be started.
    pub fn check(&self, file: &Shipped) -> Result<Item, String> {
        let output = self.run_for(file, [OsStr::new("check"), file.path.as_ref(), OsStr::new("-v")])?;
        let entries = [facts(&output), lines("stdout", &output.stdout)].concat();
        Ok(Item { place: file.name.clone(), spelling: "checked".to_owned(), entries })
    }

    /// Executes the program in the checkout.
    pub(crate) fn run(
        &self,
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    ) -> Result<Output, String> {
        self.execute(&self.program, arguments)
    }

    /// Executes the program for a file in the checkout.
    fn run_for(
        &self,
        file: &Shipped,
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    ) -> Result<Output, String> {
        let other = self.comparisons.as_ref().filter(|_| COMPARISONS.contains(&file.name.as_str()));
        self.execute(other.unwrap_or(&self.program), arguments)
    }

    fn execute(
        &self,
        program: &Path,
        arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    ) -> Result<Output, String> {
        let mut command = Command::new(program);
        command.args(arguments).current_dir(&self.checkout);
        command.output().map_err(|e| error_text(program, &e))
    }
}

/// Adds the signals of the logs to a run: those of a run with several robots are items of their own.
#[must_use]
pub fn with_signals(mut run: Item, logs: &[Log]) -> Vec<Item> {
    let mut items = Vec::new();
    let entries = |log: &Log| match &log.recording {
        Ok(recording) => hashes::of(recording),
        Err(why) => vec![Entry::new(Kind::Key, NOT_COMPARED, why)],
    };
    if logs.is_empty() && run.place != WHOLE {
        run.entries.push(Entry::new(Kind::Key, NOT_COMPARED, "it has no log"));
    }
    for log in logs {
        match &log.robot {
            None => run.entries.extend(entries(log)),
            Some(robot) => {
                let place = format!("{}/{robot}", run.place);
                items.push(Item { place, spelling: run.spelling.clone(), entries: entries(log) });
            }
        }
    }
    items.insert(0, run);
    items
}

/// Exit code and errors of the program.
fn facts(output: &Output) -> Vec<Entry> {
    let exit = output.status.code().map_or_else(|| output.status.to_string(), |code| code.to_string());
    [vec![Entry::new(Kind::Key, "(exit)", &exit)], lines("stderr", &output.stderr)].concat()
}

fn lines(name: &str, output: &[u8]) -> Vec<Entry> {
    let text = String::from_utf8_lossy(output);
    text.lines().map(|line| Entry::new(Kind::Line, name, &without_paths(line))).collect()
}

/// Reads a JSON file; `None` if there is none.
pub(crate) fn read_json(path: &Path) -> Option<Value> {
    serde_json::from_str(&fs::read_to_string(path).ok()?).ok()
}

/// Numbers of the runs of a suite, from 1, with the names of their logs.
fn logs_of_rows(path: &Path) -> Vec<(usize, String)> {
    let text = fs::read_to_string(path).unwrap_or_default();
    let rows = text.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let of_row =
        |row: Value| Some((usize::try_from(row["run"].as_u64()?).ok()?, row["log"].as_str()?.to_owned()));
    rows.filter_map(of_row).collect()
}

/// Reads a log, that in a folder, or those in the folders of robots in it.
fn read_logs(path: &Path) -> Vec<Log> {
    let own = if path.is_dir() { path.join("run.mcap") } else { path.to_owned() };
    if own.exists() {
        return vec![Log { robot: None, recording: read_log(&own) }];
    }
    let mut robots: Vec<PathBuf> = fs::read_dir(path)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path().join("run.mcap"))
        .collect();
    robots.retain(|log| log.exists());
    robots.sort();
    let name = |log: &Path| log.parent()?.file_name().map(|name| name.to_string_lossy().into_owned());
    robots.iter().map(|log| Log { robot: name(log), recording: read_log(log) }).collect()
}

/// Reads a log; an error if it is incomplete.
fn read_log(path: &Path) -> Result<Recording, String> {
    let recording = Recording::read(path).map_err(|e| e.to_string())?;
    match &recording.damage {
        Some(damage) => Err(format!("its log is damaged: {}", damage.what)),
        None if recording.dropped() > 0 => Err(format!("its log lacks {} rows", recording.dropped())),
        None => Ok(recording),
    }
}

fn remove(path: &Path) -> Result<(), String> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    removed.map_err(|e| error_text(path, &e))
}

fn error_text(path: &Path, error: &dyn Display) -> String {
    format!("{}: {error}", path.display())
}
