//! One of the compared builds: a program, and the checkout with the files that it runs.

use crate::hashes::{Hash, of};
use crate::suites::{self, Run};
use opspace_log::Recording;
use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A build.
#[derive(Clone, Debug)]
pub struct Side {
    program: PathBuf,
    checkout: PathBuf,
    duration_s: Option<f64>,
}

/// Results of a run.
#[derive(Debug)]
pub struct Made {
    /// Exit code of the run, and the fault in `summary.json`.
    pub facts: Vec<Hash>,
    /// Log of the run; if there is none, the output of the program.
    pub recording: Result<Recording, String>,
}

impl Side {
    /// Creates a build from a program and a checkout; `duration_s` replaces the durations of the tasks, s.
    ///
    /// # Errors
    /// A program or checkout that does not exist.
    pub fn new(program: &Path, checkout: &Path, duration_s: Option<f64>) -> Result<Self, String> {
        let absolute = |path: &Path| path.canonicalize().map_err(|e| error_text(path, &e));
        Ok(Self { program: absolute(program)?, checkout: absolute(checkout)?, duration_s })
    }

    /// Lists the runs of suites, in order.
    ///
    /// # Errors
    /// A suite that cannot be read.
    pub fn runs(&self, suites: &[String]) -> Result<Vec<Run>, String> {
        let runs: Result<Vec<_>, _> =
            suites.iter().map(|suite| suites::runs(&self.checkout, suite)).collect();
        Ok(runs?.concat())
    }

    /// Executes a run and reads its log. The folder must not exist; it is removed afterwards unless `keep` is true.
    ///
    /// # Errors
    /// A program that cannot be started, or a folder that cannot be removed.
    pub fn make(&self, run: &Run, folder: &Path, keep: bool) -> Result<Made, String> {
        let output = self.command(run, folder).output().map_err(|e| error_text(&self.program, &e))?;
        let made = Made {
            facts: vec![Hash::fact("exit", &exit(&output)), Hash::fact("faulted", &fault(folder))],
            recording: recording(&folder.join("run.mcap"), &output),
        };
        if !keep && folder.exists() {
            fs::remove_dir_all(folder).map_err(|e| error_text(folder, &e))?;
        }
        Ok(made)
    }

    fn command(&self, run: &Run, folder: &Path) -> Command {
        let mut command = Command::new(&self.program);
        command.current_dir(&self.checkout).args(["--quiet", "run"]).args(&run.arguments);
        if let Some(duration_s) = self.duration_s {
            command.args(["--duration-s", &duration_s.to_string()]);
        }
        command.arg("--out").arg(folder);
        command
    }
}

impl Made {
    /// Returns the hashes of all facts and signals; for a run without a complete log, only the facts.
    #[must_use]
    pub fn hashes(&self) -> Vec<Hash> {
        let signals = self.recording.as_ref().map(of).unwrap_or_default();
        [self.facts.clone(), signals].concat()
    }
}

fn exit(output: &Output) -> String {
    output.status.code().map_or_else(|| output.status.to_string(), |code| code.to_string())
}

fn fault(folder: &Path) -> String {
    let text = fs::read_to_string(folder.join("summary.json")).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    summary.get("faulted").map_or_else(|| "(not told)".to_owned(), ToString::to_string)
}

/// Reads the log; an error if it is incomplete.
fn recording(path: &Path, output: &Output) -> Result<Recording, String> {
    if !path.exists() {
        return Err(String::from_utf8_lossy(&output.stderr).into_owned());
    }
    let recording = Recording::read(path).map_err(|e| e.to_string())?;
    match &recording.damage {
        Some(damage) => Err(format!("its log is damaged: {}", damage.what)),
        None if recording.dropped() > 0 => Err(format!("its log lacks {} rows", recording.dropped())),
        None => Ok(recording),
    }
}

fn error_text(path: &Path, error: &dyn Display) -> String {
    format!("{}: {error}", path.display())
}
