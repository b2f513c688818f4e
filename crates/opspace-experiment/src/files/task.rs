//! Task files: the tasks of a robot, and its environment during the run.

use crate::extensions::{Extensions, Tables};
use crate::files::collision::ObstacleFile;
use crate::files::expectation::Expectation;
use crate::files::origin::{Files, Kind, beside};
use crate::files::overrides;
use crate::files::source::{FileError, Source, checked, explain};
use crate::files::strict::Strict;
use crate::files::task_kinds;
use crate::suggest::nearest;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_control::hierarchy::task_parameters::UNUSED_DAMPING_PER_S;
use opspace_control::{
    AxisMode, CartesianReference, Compensation, ContactCondition, LimitParameters, RecordedReason,
    TaskParameters, TimedReference, recorded,
};
use opspace_sim::EnvironmentObjectParameters;
use opspace_transformer::FrictionCompensationParameters;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

/// Longest run, s, 11.6 days: a longer one is a mistake in a unit.
pub(crate) const LONGEST_RUN_S: f64 = 1e6;

/// Largest number of events of a task: `opspace check` takes some seconds for as many.
const MAX_EVENTS: usize = 1000;

/// Contents of a task file.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct TaskFile {
    /// Robot of the task: its folder or its robot.toml; the path is relative to this file.
    pub robot: PathBuf,
    /// Duration of control, s.
    #[cfg_attr(feature = "schema", schemars(extend("maximum" = LONGEST_RUN_S)))]
    pub duration_s: Positive,
    /// Start of the statistics, s after the start of control.
    #[serde(default)]
    pub settle_s: NonNegative,
    /// Seed of all random numbers in a simulation.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Names of the tasks, in order of decreasing priority; if empty, only the compensation acts.
    #[cfg_attr(feature = "schema", schemars(extend("uniqueItems" = true)))]
    pub priority: Vec<String>,
    /// Parameters of the tasks, by name.
    #[serde(default)]
    pub task: BTreeMap<String, TaskParameters>,
    /// Compensation of gravity, and of Coriolis and centrifugal forces.
    #[serde(default)]
    pub compensation: Compensation,
    /// Damping of the motion that the tasks leave, if the last one is not of all joints (deceleration per velocity), 1/s.
    /// With 10, motion without a task, which sensor noise would start, ends within some tenths of a second. It also brakes
    /// directions close to a singularity. At most a fifth of the control rate.
    #[serde(default = "unused_damping")]
    pub unused_damping_per_s: Positive,
    /// Enforcement of the robot's limits.
    #[serde(default)]
    pub limits: LimitParameters,
    /// Compensation of friction.
    #[serde(default)]
    pub friction_compensation: FrictionCompensationParameters,
    /// Start positions of the joints by joint name, rad (m); 0 for omitted joints. A simulated robot starts there at
    /// rest; a real robot must already be there, or be moved there with `run --move-to-start`.
    #[serde(default)]
    pub start_rad: BTreeMap<String, f64>,
    /// Bounds on metrics of the run; a run that misses one ends with exit code 1. Names are those of summary.json: of the
    /// run, or `TASK.metric` and `JOINT.metric`.
    #[serde(default)]
    pub expect: BTreeMap<String, Expectation>,
    /// Changes of the tasks during the run, in order of time.
    #[serde(default)]
    pub event: Vec<EventFile>,
    /// Objects in the environment of a simulated robot, by name.
    #[serde(default)]
    pub environment: BTreeMap<String, EnvironmentObjectParameters>,
    /// Obstacles that the controller avoids, by name, if it enforces limits. The robot needs `[collision]`.
    #[serde(default)]
    pub obstacle: BTreeMap<String, ObstacleFile>,
}

/// A change of the tasks while the controller runs.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EventFile {
    /// Time of the change, s after the start of control.
    pub time_s: Positive,
    /// Contact at which the change takes place before `time_s`, but after the event before it.
    pub contact: Option<EventContact>,
    /// Settings from this time on, written as on the command line: `"task.hand.cartesian.axes.x=compliant"`,
    /// `"priority=[\"hand\"]"`. Only `task` and `priority` can change.
    pub set: Vec<String>,
}

/// Contact of a task that approaches (`force.contact`).
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EventContact {
    /// Name of the task.
    pub task: String,
    /// Contact is made, or lost.
    pub is: ContactChange,
    /// Time for which this must last, s.
    #[serde(default = "default_lasting")]
    pub for_s: NonNegative,
}

const fn default_lasting() -> NonNegative {
    NonNegative::literal(0.1)
}

/// Change of a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ContactChange {
    /// All force axes of the task touch.
    Made,
    /// One of them does not touch.
    Lost,
}

impl ContactChange {
    /// Name in the file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Made => "made",
            Self::Lost => "lost",
        }
    }
}

impl EventContact {
    /// The condition for the controller.
    pub(crate) fn condition(&self) -> ContactCondition {
        ContactCondition {
            task: self.task.clone(),
            made: self.is == ContactChange::Made,
            for_s: self.for_s.get(),
        }
    }
}

/// Task set that is active from a given time.
#[derive(Clone, Debug)]
pub struct StackFile {
    /// Latest time from which the set is active, s after the start of control.
    pub time_s: f64,
    /// Contact from which the set is active before this time.
    pub contact: Option<ContactCondition>,
    /// Names of the tasks, in order of decreasing priority.
    pub priority: Vec<String>,
    /// Parameters of the tasks, by name.
    pub task: BTreeMap<String, TaskParameters>,
}

const fn unused_damping() -> Positive {
    UNUSED_DAMPING_PER_S
}

pub(super) const fn default_seed() -> u64 {
    1
}

/// Task definition, read from its files and parsed.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct TaskDefinition {
    /// Text of the task file, with settings applied.
    pub source: Source,
    /// Parameters in the task file.
    pub file: TaskFile,
    /// Recorded paths that the tasks follow, by file path as written in the task file.
    pub recordings: BTreeMap<PathBuf, Source>,
    /// Task sets after each of the file's events.
    pub events: Vec<StackFile>,
    /// Entries of tables that the program has added.
    pub tables: Tables,
}

impl TaskDefinition {
    /// Parameters of the tasks, by name: those of the file, and those after each event.
    pub(crate) fn task_sets_mut(&mut self) -> impl Iterator<Item = &mut BTreeMap<String, TaskParameters>> {
        std::iter::once(&mut self.file.task).chain(self.events.iter_mut().map(|event| &mut event.task))
    }

    /// Reads a task and the recorded paths to which it refers. `settings` change values in the task file.
    ///
    /// # Errors
    /// Mistakes in the files, each with its place.
    pub fn load(files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        Self::load_with(&Extensions::default(), files, path, settings)
    }

    /// Reads a task like [`load`](Self::load), with the task kinds and metrics of `extensions`.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_with(
        extensions: &Extensions,
        files: Files,
        path: &Path,
        settings: &[String],
    ) -> Result<Self, FileError> {
        let source = files.read(path)?;
        Kind::Task.require(&source)?;
        let source = overrides::apply(&source, settings)?;
        Self::from_sources_with(extensions, source, |named| {
            files.read_named(&named.path, named.by, named.key)
        })
    }

    /// Reads a task from its text; `read` reads the recorded paths to which it refers.
    ///
    /// # Errors
    /// As [`load`](Self::load), and those of `read`.
    pub fn from_sources<E: From<FileError>>(
        source: Source,
        read: impl FnMut(NamedRecording<'_>) -> Result<Source, E>,
    ) -> Result<Self, E> {
        Self::from_sources_with(&Extensions::default(), source, read)
    }

    /// Reads a task like [`from_sources`](Self::from_sources), with the task kinds and metrics of `extensions`.
    ///
    /// # Errors
    /// As [`from_sources`](Self::from_sources).
    pub fn from_sources_with<E: From<FileError>>(
        extensions: &Extensions,
        source: Source,
        mut read: impl FnMut(NamedRecording<'_>) -> Result<Source, E>,
    ) -> Result<Self, E> {
        let mut file = parse_task(&source, extensions)?;
        let mut events = after_events(&source, &file, extensions)?;
        keep_used_tasks(&mut file, &mut events);
        let mut recordings = BTreeMap::new();
        let mut paths: Vec<TimedReference> = Vec::new();
        let stacks = events.iter_mut().map(|stack| &mut stack.task);
        for (task, parameters) in std::iter::once(&mut file.task).chain(stacks).flatten() {
            let (kind, reference) = match parameters {
                TaskParameters::Cartesian(task) => ("cartesian", &mut task.reference),
                TaskParameters::CenterOfMass(task) => ("center-of-mass", &mut task.reference),
                _ => continue,
            };
            if let CartesianReference::Path(path) = reference {
                // Each event reads the task again: equal paths are one, whose motion is computed once.
                match paths.iter().find(|known| *known == path) {
                    Some(known) => *path = known.clone(),
                    None => paths.push(path.clone()),
                }
            }
            let CartesianReference::Recorded(recorded) = reference else { continue };
            if !recordings.contains_key(&recorded.file) {
                let key = ["task", task, kind, "reference", "recorded", "file"];
                let path = beside(Path::new(source.name()), &recorded.file);
                let recording = read(NamedRecording { file: &recorded.file, path, by: &source, key })?;
                recordings.insert(recorded.file.clone(), recording);
            }
            recorded.samples = samples(&recordings[&recorded.file])?;
        }
        let tables = Tables::clone(extensions);
        Ok(Self { source, file, recordings, events, tables })
    }

    /// Name of the task: its file name without extension.
    #[must_use]
    pub fn name(&self) -> String {
        let stem = Path::new(self.source.name()).file_stem();
        stem.map_or_else(|| self.source.name().to_owned(), |s| s.to_string_lossy().into_owned())
    }

    /// Tasks that have a priority at some time of the run: those at the start in the order of priority, and then those
    /// to which an event gives one, each as it is then.
    pub fn tasks_of_the_run(&self) -> Vec<(&str, &TaskParameters)> {
        let sets = std::iter::once((&self.file.priority, &self.file.task))
            .chain(self.events.iter().map(|event| (&event.priority, &event.task)));
        let mut tasks: Vec<(&str, &TaskParameters)> = Vec::new();
        for (priority, parameters) in sets {
            for name in priority {
                let is_new = tasks.iter().all(|(known, _)| known != name);
                if let Some(parameters) = parameters.get(name).filter(|_| is_new) {
                    tasks.push((name, parameters));
                }
            }
        }
        tasks
    }

    /// Path of the task's robot.
    #[must_use]
    pub fn robot_path(&self) -> PathBuf {
        beside(Path::new(self.source.name()), &self.file.robot)
    }
}

/// Recorded path to which a task refers.
pub struct NamedRecording<'a> {
    /// Path of the recording, as written in the task file.
    pub file: &'a Path,
    /// Path of the recording, resolved relative to the folder of the task file.
    pub path: PathBuf,
    by: &'a Source,
    key: [&'a str; 6],
}

/// Parses a task file with tasks of built-in and registered kinds.
fn parse_task(source: &Source, extensions: &Extensions) -> Result<TaskFile, FileError> {
    let mut document = checked(source)?;
    let whole = document.clone();
    let registered = task_kinds::take(extensions, source, &mut document)?;
    let mut file = TaskFile::deserialize(Strict(toml::de::Deserializer::from(document)))
        .map_err(|error| explain::<TaskFile>(source, whole.get_ref(), &error))?;
    file.task.extend(registered);
    Ok(file)
}

/// Returns the task set after each event; each event changes the set left by the previous one.
fn after_events(
    source: &Source,
    file: &TaskFile,
    extensions: &Extensions,
) -> Result<Vec<StackFile>, FileError> {
    if file.event.len() > MAX_EVENTS {
        let message = format!("{} events; at most {MAX_EVENTS} are accepted", file.event.len());
        let help = "each is a set of tasks that is built before the run; a reference moves without events";
        return Err(FileError::at_key(source, ["event"], message, Some(help.to_owned())));
    }
    let mut stacks: Vec<StackFile> = Vec::new();
    let mut before = without_events(source);
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
        }
        let changed = overrides::apply(&before, &event.set).and_then(|text| {
            let changed = parse_task(&text, extensions)?;
            before = Source::new(source.name(), text.text());
            Ok(changed)
        });
        let changed = changed
            .map_err(|error| at("set", error.message().to_owned(), error.help().map(str::to_owned)))?;
        let contact = match &event.contact {
            Some(contact) => {
                let before =
                    stacks.last().map_or((&file.priority, &file.task), |set| (&set.priority, &set.task));
                if !approaches(before, &contact.task) {
                    let message =
                        format!("no task '{}' that approaches is active before this event", contact.task);
                    let help = "name a task with a `force` axis and `force.contact`".to_owned();
                    return Err(at("contact", message, Some(help)));
                }
                Some(contact.condition())
            }
            None => None,
        };
        stacks.push(StackFile { time_s, contact, priority: changed.priority, task: changed.task });
    }
    Ok(stacks)
}

/// Text of a task without its events: each event changes it, and would otherwise read all of them again.
fn without_events(source: &Source) -> Source {
    let Ok(mut document) = source.text().parse::<DocumentMut>() else { return source.clone() };
    document.remove("event");
    Source::new(source.name(), document.to_string())
}

/// True if a task of a set has axes that approach until they touch.
fn approaches((priority, tasks): (&Vec<String>, &BTreeMap<String, TaskParameters>), name: &str) -> bool {
    let Some(TaskParameters::Cartesian(task)) = tasks.get(name) else { return false };
    let touches = task.force.as_ref().is_some_and(|force| force.contact.is_some());
    priority.iter().any(|other| other == name) && task.axes.modes().contains(&AxisMode::Force) && touches
}

/// Removes from each task set the tasks that have a priority only in other sets.
fn keep_used_tasks(file: &mut TaskFile, events: &mut [StackFile]) {
    let priorities = events.iter().map(|event| &event.priority).chain([&file.priority]);
    let used: BTreeSet<String> = priorities.flatten().cloned().collect();
    let sets = events.iter_mut().map(|event| (&event.priority, &mut event.task));
    for (priority, tasks) in sets.chain([(&file.priority, &mut file.task)]) {
        tasks.retain(|name, _| priority.contains(name) || !used.contains(name));
    }
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
