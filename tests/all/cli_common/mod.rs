//! Helpers that start the program as its users do.

#![allow(dead_code, reason = "each test uses some of it")]

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

pub const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// Path in the project, as text.
pub fn project(path: &str) -> String {
    format!("{ROOT}/{path}")
}

/// Output and exit code of a command.
pub struct Ran {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Ran {
    #[track_caller]
    pub fn exits(self, code: i32) -> Self {
        assert_eq!(self.code, code, "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
        self
    }

    /// Checks that stderr contains each of the words.
    #[track_caller]
    pub fn says(self, words: &[&str]) -> Self {
        for word in words {
            assert!(self.stderr.contains(word), "'{word}' isn't said:\n{}", self.stderr);
        }
        self
    }

    /// Checks that stdout contains each of the words.
    #[track_caller]
    pub fn prints(self, words: &[&str]) -> Self {
        for word in words {
            assert!(self.stdout.contains(word), "'{word}' isn't printed:\n{}", self.stdout);
        }
        self
    }

    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}:\n{}", self.stdout))
    }
}

/// Returns a command that starts the program in a folder, without a terminal.
pub fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_opspace"));
    command.args(arguments).current_dir(folder).stdin(Stdio::null());
    command
}

/// Runs `opspace` in a folder, and checks that it neither panics nor is killed.
#[track_caller]
pub fn opspace(folder: &Path, arguments: &[&str]) -> Ran {
    let output = command(folder, arguments).output().expect("it starts");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("its output is UTF-8");
    let (stdout, stderr) = (text(output.stdout), text(output.stderr));
    assert!(!stderr.contains("panicked"), "{arguments:?}:\n{stderr}");
    let code = output.status.code().unwrap_or_else(|| panic!("{arguments:?}: {}", output.status));
    Ran { code, stdout, stderr }
}

/// Creates a folder that is removed after the test.
pub fn scratch() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Runs a task of the project for two seconds into `folder/name`, and returns the path of the log.
#[track_caller]
pub fn run(folder: &Path, name: &str, task: &str, options: &[&str]) -> PathBuf {
    let task = project(&format!("tasks/{task}.toml"));
    let arguments = [&["run", &task, "--duration-s", "2.0", "--out", name], options].concat();
    opspace(folder, &arguments).exits(0);
    folder.join(name).join("run.mcap")
}

pub fn read(path: impl AsRef<Path>) -> String {
    let path = path.as_ref();
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

pub fn read_json(path: impl AsRef<Path>) -> Value {
    serde_json::from_str(&read(path)).expect("JSON")
}

/// A circle of the planar arm: half a second, so that a run takes little time.
const CIRCLE: &str = r#"
robot = "ROBOT"
duration_s = 0.5
settle_s = 0.2
priority = ["tip"]
start_rad = { shoulder = 0.6, elbow = 1.2 }
[task.tip.cartesian]
frame = "tip"
axes = { x = "motion", z = "motion" }
gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }
reference.sinusoid.x = [{ amplitude_m = 0.1, frequency_hz = 0.5 }]
"#;

/// Creates a folder with the task `circle.toml` and the suite `suite.toml`.
pub fn circle_folder(suite: &str) -> tempfile::TempDir {
    let folder = scratch();
    let task = CIRCLE.replace("ROBOT", &project("robots/planar-2-link"));
    fs::write(folder.path().join("circle.toml"), task).expect("a new folder");
    fs::write(folder.path().join("suite.toml"), suite).expect("a new folder");
    folder
}
