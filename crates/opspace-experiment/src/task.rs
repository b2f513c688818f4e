//! Task files: what the robot is to do, and what surrounds it while it does.

use crate::files::{Files, Kind, beside};
use crate::names::nearest;
use crate::overrides;
use crate::source::{FileError, Source, parse};
use opspace_backend::FrictionCompensationParameters;
use opspace_control::quantity::{NonNegative, Positive};
use opspace_control::{
    CartesianReference, Compensation, LimitParameters, RecordedReason, TaskParameters, recorded,
};
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
    /// How the robot's limits are kept.
    #[serde(default)]
    pub limits: LimitParameters,
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
    /// The recorded paths that its tasks follow, by the tasks' names.
    pub recordings: BTreeMap<String, Source>,
}

impl Task {
    /// Reads a task, and the recorded paths that it names. `settings` change values in it.
    ///
    /// # Errors
    /// What is wrong in the files, with its place.
    pub fn load(files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        let source = files.read(path)?;
        Kind::Task.require(&source)?;
        let source = overrides::apply(&source, settings)?;
        Self::from_sources(source, |named| files.read_named(&named.path, named.by, named.key))
    }

    /// A task from its text; `read` finds the recorded paths that it names.
    ///
    /// # Errors
    /// As [`load`](Self::load), and those of `read`.
    pub fn from_sources<E: From<FileError>>(
        source: Source,
        mut read: impl FnMut(NamedRecording<'_>) -> Result<Source, E>,
    ) -> Result<Self, E> {
        let mut file: TaskFile = parse(&source)?;
        let mut recordings = BTreeMap::new();
        for (task, parameters) in &mut file.task {
            let (kind, reference) = match parameters {
                TaskParameters::Cartesian(task) => ("cartesian", &mut task.reference),
                TaskParameters::CenterOfMass(task) => ("center-of-mass", &mut task.reference),
                _ => continue,
            };
            let CartesianReference::Recorded(recorded) = reference else { continue };
            let key = ["task", task, kind, "reference", "recorded", "file"];
            let path = beside(Path::new(source.name()), &recorded.file);
            let recording = read(NamedRecording { task, path, by: &source, key })?;
            recorded.samples = samples(&recording)?;
            recordings.insert(task.clone(), recording);
        }
        Ok(Self { source, file, recordings })
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

/// A recorded path that a task names.
pub struct NamedRecording<'a> {
    /// The task.
    pub task: &'a str,
    /// Its file.
    pub path: PathBuf,
    by: &'a Source,
    key: [&'a str; 6],
}

/// The samples of a recorded path.
fn samples(recording: &Source) -> Result<Vec<recorded::PoseSample>, FileError> {
    recorded::parse(recording.text()).map_err(|error| {
        let help = match &error.reason {
            RecordedReason::UnknownColumn { name } => {
                nearest(name, &recorded::COLUMNS).map(|near| format!("did you mean `{near}`?"))
            }
            _ => None,
        };
        let line = error.line.and_then(|line| usize::try_from(line).ok());
        FileError::at_line(recording, line, error.reason.to_string(), help)
    })
}
