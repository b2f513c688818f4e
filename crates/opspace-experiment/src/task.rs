//! Task files: what the robot is to do, and what surrounds it while it does.

use crate::files::{Files, Kind, beside};
use crate::overrides;
use crate::source::{FileError, Source, parse};
use opspace_backend::FrictionCompensationParameters;
use opspace_control::quantity::{NonNegative, Positive};
use opspace_control::{Compensation, TaskParameters};
use opspace_sim::SurroundingParameters;
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A task file, as it is written.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskFile {
    /// The robot it is for: its folder or its robot.toml; the path counts from this file.
    pub robot: PathBuf,
    /// How long the controller runs, s.
    pub duration_s: Positive,
    /// From when on statistics count, s.
    #[serde(default)]
    pub settle_s: NonNegative,
    /// Of everything random in a simulation.
    #[serde(default = "one")]
    pub seed: u64,
    /// The tasks by name, the most important first; empty leaves only the compensation.
    pub priority: Vec<String>,
    /// The tasks, by name.
    #[serde(default)]
    pub task: BTreeMap<String, TaskParameters>,
    /// Which of the arm's own torques are compensated.
    #[serde(default)]
    pub compensation: Compensation,
    /// How much friction is compensated.
    #[serde(default)]
    pub friction_compensation: FrictionCompensationParameters,
    /// Where a simulated robot starts, at rest, by joint name, rad (m); joints left out start at 0.
    #[serde(default)]
    pub start_rad: BTreeMap<String, f64>,
    /// What touches a simulated robot, by name.
    #[serde(default)]
    pub surroundings: BTreeMap<String, SurroundingParameters>,
}

const fn one() -> u64 {
    1
}

/// A task, read and parsed.
#[derive(Clone, Debug)]
pub struct Task {
    /// Its file's text, settings applied.
    pub source: Source,
    /// Its file.
    pub file: TaskFile,
}

impl Task {
    /// Reads a task. `settings` change values in it.
    ///
    /// # Errors
    /// What is wrong in the file, with its place.
    pub fn load(files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        let source = files.read(path)?;
        Kind::Task.require(&source)?;
        Self::from_source(overrides::apply(&source, settings)?)
    }

    /// A task from its text.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn from_source(source: Source) -> Result<Self, FileError> {
        let file = parse(&source)?;
        Ok(Self { source, file })
    }

    /// The task's name: that of its file.
    #[must_use]
    pub fn name(&self) -> String {
        let stem = Path::new(self.source.name()).file_stem();
        stem.map_or_else(|| self.source.name().to_owned(), |s| s.to_string_lossy().into_owned())
    }

    /// Where its robot is.
    #[must_use]
    pub fn robot_path(&self) -> PathBuf {
        beside(Path::new(self.source.name()), &self.file.robot)
    }
}
