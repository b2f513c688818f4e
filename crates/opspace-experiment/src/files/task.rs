//! Task files: the tasks of a robot, and its environment during the run.

use crate::files::origin::{Files, Kind, beside};
use crate::files::overrides;
use crate::files::source::{FileError, Source, checked, explain};
use crate::files::suggest::nearest;
use crate::files::task_kinds::TaskKinds;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_control::{
    CartesianReference, Compensation, LimitParameters, RecordedReason, TaskParameters, recorded,
};
use opspace_sim::EnvironmentObjectParameters;
use opspace_transformer::FrictionCompensationParameters;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A task file, as it is written.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct TaskFile {
    /// Robot of the task: its folder or its robot.toml; the path is relative to this file.
    pub robot: PathBuf,
    /// Duration of control, s.
    pub duration_s: Positive,
    /// Time from which statistics count, s after the controller's start.
    #[serde(default)]
    pub settle_s: NonNegative,
    /// Seed of all random numbers in a simulation.
    #[serde(default = "one")]
    pub seed: u64,
    /// Tasks by name, in the order of priority; empty leaves only the compensation.
    pub priority: Vec<String>,
    /// Parameters of the tasks, by name.
    #[serde(default)]
    pub task: BTreeMap<String, TaskParameters>,
    /// Compensation of the arm's own torques.
    #[serde(default)]
    pub compensation: Compensation,
    /// Enforcement of the robot's limits.
    #[serde(default)]
    pub limits: LimitParameters,
    /// Compensation of friction.
    #[serde(default)]
    pub friction_compensation: FrictionCompensationParameters,
    /// Joint positions at the start by joint name, rad (m); 0 for joints left out. A simulated robot is put there, at
    /// rest; a real one must be there, or be moved there (`run --move-to-start`).
    #[serde(default)]
    pub start_rad: BTreeMap<String, f64>,
    /// Changes of the tasks during the run, in the order of time.
    #[serde(default)]
    pub event: Vec<EventFile>,
    /// Objects in the environment of a simulated robot, by name.
    #[serde(default)]
    pub environment: BTreeMap<String, EnvironmentObjectParameters>,
}

/// A change of the tasks while the controller runs.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EventFile {
    /// Time of the change, s after the controller's start.
    pub time_s: Positive,
    /// Settings from then on, written as on the command line: `"task.hand.cartesian.axes.x=compliant"`,
    /// `"priority=[\"hand\"]"`. Only `task` and `priority` can change.
    pub set: Vec<String>,
}

/// A task set that is in force from a given time.
#[derive(Clone, Debug)]
pub struct StackFile {
    /// Time from which the set is in force, s after the controller's start.
    pub time_s: f64,
    /// Tasks by name, in the order of priority.
    pub priority: Vec<String>,
    /// Parameters of the tasks, by name.
    pub task: BTreeMap<String, TaskParameters>,
}

const fn one() -> u64 {
    1
}

/// A task, read and parsed.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TaskDefinition {
    /// Text of the task's file, settings applied.
    pub source: Source,
    /// Parameters in the task's file.
    pub file: TaskFile,
    /// Recorded paths that the tasks follow, by the path as the file gives it.
    pub recordings: BTreeMap<PathBuf, Source>,
    /// Task sets after each of the file's events.
    pub events: Vec<StackFile>,
}

impl TaskDefinition {
    /// Reads a task, and the recorded paths that it names. `settings` change values in it.
    ///
    /// # Errors
    /// Mistakes in the files, each with its place.
    pub fn load(files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        Self::load_with(&TaskKinds::new(), files, path, settings)
    }

    /// Reads a task like [`load`](Self::load), with kinds of tasks beside the built-in ones.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_with(
        kinds: &TaskKinds,
        files: Files,
        path: &Path,
        settings: &[String],
    ) -> Result<Self, FileError> {
        let source = files.read(path)?;
        Kind::Task.require(&source)?;
        let source = overrides::apply(&source, settings)?;
        Self::from_sources_with(kinds, source, |named| files.read_named(&named.path, named.by, named.key))
    }

    /// Reads a task from its text; `read` reads the recorded paths that it names.
    ///
    /// # Errors
    /// As [`load`](Self::load), and those of `read`.
    pub fn from_sources<E: From<FileError>>(
        source: Source,
        read: impl FnMut(NamedRecording<'_>) -> Result<Source, E>,
    ) -> Result<Self, E> {
        Self::from_sources_with(&TaskKinds::new(), source, read)
    }

    /// Reads a task like [`from_sources`](Self::from_sources), with kinds of tasks beside the built-in ones.
    ///
    /// # Errors
    /// As [`from_sources`](Self::from_sources).
    pub fn from_sources_with<E: From<FileError>>(
        kinds: &TaskKinds,
        source: Source,
        mut read: impl FnMut(NamedRecording<'_>) -> Result<Source, E>,
    ) -> Result<Self, E> {
        let mut file = parse_task(&source, kinds)?;
        let mut events = after_events(&source, &file, kinds)?;
        let mut recordings = BTreeMap::new();
        let stacks = events.iter_mut().map(|stack| &mut stack.task);
        for (task, parameters) in std::iter::once(&mut file.task).chain(stacks).flatten() {
            let (kind, reference) = match parameters {
                TaskParameters::Cartesian(task) => ("cartesian", &mut task.reference),
                TaskParameters::CenterOfMass(task) => ("center-of-mass", &mut task.reference),
                _ => continue,
            };
            let CartesianReference::Recorded(recorded) = reference else { continue };
            if !recordings.contains_key(&recorded.file) {
                let key = ["task", task, kind, "reference", "recorded", "file"];
                let path = beside(Path::new(source.name()), &recorded.file);
                let recording = read(NamedRecording { file: &recorded.file, path, by: &source, key })?;
                recordings.insert(recorded.file.clone(), recording);
            }
            recorded.samples = samples(&recordings[&recorded.file])?;
        }
        Ok(Self { source, file, recordings, events })
    }

    /// Name of the task: that of its file.
    #[must_use]
    pub fn name(&self) -> String {
        let stem = Path::new(self.source.name()).file_stem();
        stem.map_or_else(|| self.source.name().to_owned(), |s| s.to_string_lossy().into_owned())
    }

    /// Path of the task's robot.
    #[must_use]
    pub fn robot_path(&self) -> PathBuf {
        beside(Path::new(self.source.name()), &self.file.robot)
    }
}

/// A recorded path that a task names.
pub struct NamedRecording<'a> {
    /// File of the recording, as the task file gives it.
    pub file: &'a Path,
    /// Path of the file.
    pub path: PathBuf,
    by: &'a Source,
    key: [&'a str; 6],
}

/// Parses a task file, with tasks of built-in and of registered kinds.
fn parse_task(source: &Source, kinds: &TaskKinds) -> Result<TaskFile, FileError> {
    let mut document = checked(source)?;
    let whole = document.clone();
    let registered = kinds.take(source, &mut document)?;
    let mut file = TaskFile::deserialize(toml::de::Deserializer::from(document))
        .map_err(|error| explain::<TaskFile>(source, whole.get_ref(), &error))?;
    file.task.extend(registered);
    Ok(file)
}

/// Returns the task sets after each event: an event changes the set that the one before it has left.
fn after_events(source: &Source, file: &TaskFile, kinds: &TaskKinds) -> Result<Vec<StackFile>, FileError> {
    let mut stacks: Vec<StackFile> = Vec::new();
    let mut settings = Vec::new();
    for (number, event) in file.event.iter().enumerate() {
        let number = number.to_string();
        let at = |key: &'static str, message: String, help: Option<String>| {
            FileError::at_key(source, ["event", &number, key], message, help)
        };
        let time_s = event.time_s.get();
        if let Some(before) = stacks.last().filter(|before| before.time_s >= time_s) {
            let message =
                format!("the event at {time_s} s is not after the previous one at {} s", before.time_s);
            return Err(at("time_s", message, None));
        }
        for setting in &event.set {
            let key = setting.split(['.', '=']).next().unwrap_or_default().trim();
            if key != "task" && key != "priority" {
                let message = format!("`{setting}`: an event can change only `task` and `priority`");
                return Err(at(
                    "set",
                    message,
                    Some("for example \"task.hand.cartesian.axes.x=compliant\"".to_owned()),
                ));
            }
            settings.push(setting.clone());
        }
        let changed = overrides::apply(source, &settings).and_then(|changed| parse_task(&changed, kinds));
        let changed = changed
            .map_err(|error| at("set", error.message().to_owned(), error.help().map(str::to_owned)))?;
        stacks.push(StackFile { time_s, priority: changed.priority, task: changed.task });
    }
    Ok(stacks)
}

/// Reads the samples of a recorded path.
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
