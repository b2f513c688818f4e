//! Task files: what the robot is to do, and what surrounds it while it does.

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
    /// Joint positions at the start by joint name, rad (m); 0 for joints left out. A simulated robot is put there, at rest;
    /// a real one must be there, or be moved there (`run --move-to-start`).
    #[serde(default)]
    pub start_rad: BTreeMap<String, f64>,
    /// What changes while the controller runs, in the order of time.
    #[serde(default)]
    pub event: Vec<EventFile>,
    /// What touches a simulated robot, by name.
    #[serde(default)]
    pub surroundings: BTreeMap<String, EnvironmentObjectParameters>,
}

/// A change of the tasks while the controller runs.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EventFile {
    /// When, s after the controller's start.
    pub time_s: Positive,
    /// What changes from then on, written as on the command line: `"task.hand.cartesian.axes.x=compliant"`,
    /// `"priority=[\"hand\"]"`. Only `task` and `priority` can change.
    pub set: Vec<String>,
}

/// The tasks that are in force from a time on.
#[derive(Clone, Debug)]
pub struct StackFile {
    /// s after the controller's start.
    pub time_s: f64,
    /// The tasks by name, the most important first.
    pub priority: Vec<String>,
    /// The tasks, by name.
    pub task: BTreeMap<String, TaskParameters>,
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
    /// The recorded paths that its tasks follow, by the path as the file gives it.
    pub recordings: BTreeMap<PathBuf, Source>,
    /// The tasks after each of the file's events.
    pub events: Vec<StackFile>,
}

impl Task {
    /// Reads a task, and the recorded paths that it names. `settings` change values in it.
    ///
    /// # Errors
    /// What is wrong in the files, with its place.
    pub fn load(files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        Self::load_with(&TaskKinds::new(), files, path, settings)
    }

    /// As [`load`](Self::load), with kinds of tasks beside the built-in ones.
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

    /// A task from its text; `read` finds the recorded paths that it names.
    ///
    /// # Errors
    /// As [`load`](Self::load), and those of `read`.
    pub fn from_sources<E: From<FileError>>(
        source: Source,
        read: impl FnMut(NamedRecording<'_>) -> Result<Source, E>,
    ) -> Result<Self, E> {
        Self::from_sources_with(&TaskKinds::new(), source, read)
    }

    /// As [`from_sources`](Self::from_sources), with kinds of tasks beside the built-in ones.
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
    /// Its file as the task file gives it.
    pub file: &'a Path,
    /// Where that is.
    pub path: PathBuf,
    by: &'a Source,
    key: [&'a str; 6],
}

/// A task file, with tasks of built-in and of registered kinds.
fn parse_task(source: &Source, kinds: &TaskKinds) -> Result<TaskFile, FileError> {
    let mut document = checked(source)?;
    let whole = document.clone();
    let registered = kinds.take(source, &mut document)?;
    let mut file = TaskFile::deserialize(toml::de::Deserializer::from(document))
        .map_err(|error| explain::<TaskFile>(source, whole.get_ref(), &error))?;
    file.task.extend(registered);
    Ok(file)
}

/// The tasks after each event: an event changes what the one before has left.
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
                format!("the event at {time_s} s does not come after the one at {} s", before.time_s);
            return Err(at("time_s", message, None));
        }
        for setting in &event.set {
            let key = setting.split(['.', '=']).next().unwrap_or_default().trim();
            if key != "task" && key != "priority" {
                let message = format!("`{setting}`: an event changes `task` and `priority` alone");
                return Err(at(
                    "set",
                    message,
                    Some("as in \"task.hand.cartesian.axes.x=compliant\"".to_owned()),
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
