//! Class `Experiment`: a task on a robot.

use crate::arrays::vector;
use crate::control_loop::ControlLoop;
use crate::control_loops::ControlLoops;
use crate::entries::Entries;
use crate::errors::{FaultText, argument, caught, of_file, of_run};
use crate::interrupt::interruptible;
use crate::model::Model;
use crate::python_robot::PythonRobot;
use crate::result::{Result, StoredLog};
use crate::run::Run;
use crate::simulation::Simulation;
use crate::stepping::LogSink;
use crate::toml_text::{table, value};
use opspace_backend::CommandKind;
use opspace_experiment::files::origin::Kind;
use opspace_experiment::files::overrides;
use opspace_experiment::{
    Code, ControllerKind, Extensions, FileError, Files, Place, Progress, RobotDefinition, RunError,
    RunOptions, RunResult, Source, Summary, TaskDefinition,
};
use opspace_log::Recording;
use opspace_loop::RunOutcome;
use opspace_preflight::problems;
use opspace_report::folder::in_folder;
use opspace_transformer::TransformerName;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyString};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Cursor, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use toml::{Table, Value};

/// Names of the texts of dictionaries, in messages.
const TASK: &str = "task";
const ROBOT: &str = "robot";

/// File, or the text of a dictionary.
enum Part {
    Path(PathBuf),
    Dictionary(Table),
}

impl Part {
    fn new(name: &str, object: &Bound<'_, PyAny>) -> PyResult<Self> {
        if let Ok(dictionary) = object.cast::<PyDict>() {
            let table = table(name, dictionary)?;
            if name == ROBOT && !table.contains_key("urdf") {
                return Err(argument(name, "the key `urdf` is missing: the path of the robot's URDF"));
            }
            return Ok(Self::Dictionary(table));
        }
        let path: PathBuf =
            object.extract().map_err(|_| argument(name, "expected a path or a dictionary"))?;
        let is_name = path.components().count() == 1 && path.extension().is_none();
        if is_name && !path.exists() {
            let (path, kind) = (path.display(), if name == ROBOT { "robots" } else { "tasks" });
            return Err(argument(
                name,
                &format!(
                    "there is no `{path}`; opspace.{kind}() returns the paths of the package's {kind} by name"
                ),
            ));
        }
        Ok(Self::Path(path))
    }
}

/// Text of a dictionary as a file of this name.
fn source(name: &str, table: &Table) -> std::result::Result<Source, FileError> {
    match toml::to_string(table) {
        Ok(text) => Ok(Source::new(name, text)),
        Err(error) => Err(FileError::of_file(name, error.to_string(), None)),
    }
}

/// Task on a robot, read and checked: all its parts can be built.
///
/// task: path of a task file, or a dictionary with the keys of one. robot: path of the robot's folder, or a dictionary with the
/// keys of robot.toml; None is the robot that the task names. Paths in a dictionary are relative to the working folder.
///
/// backend: "position", "velocity" or "torque"; None is what robot.toml declares. controller: "osc", "ik" or "ik-lead".
/// transformer and profile replace those of the robot file, duration_s (s) and seed those of the task. set: settings as of
/// `--set`, a sequence of "key=value" or a dictionary. allow: codes of refusals that are allowed.
///
/// An experiment can be pickled, and is a constant: several threads and processes may run it.
///
/// tasks: classes of tasks by the names of their kinds, `[task.NAME.KIND]`. metrics: classes of metrics by their keys. The page "Tasks
/// and metrics in Python" describes both. A cycle and a summary then take Python's time, and an exception stops the robot and is raised
/// with its traceback.
///
/// Raises OpspaceError for a mistake, with file, line, key and help.
#[pyclass(frozen, module = "opspace")]
pub(crate) struct Experiment {
    pub(crate) experiment: Arc<opspace_experiment::Experiment>,
    /// Parts that are dictionaries, by their names.
    dictionaries: Vec<&'static str>,
    entries: Entries,
}

/// Function that builds an experiment again, and its arguments.
type Reduced<'py> = (
    Bound<'py, PyAny>,
    (Bound<'py, PyBytes>, Vec<&'static str>, Option<Bound<'py, PyDict>>, Option<Bound<'py, PyDict>>),
);

/// Options of the constructor.
struct Options {
    task: Part,
    robot: Option<Part>,
    backend: Option<CommandKind>,
    options: RunOptions,
    settings: Vec<String>,
}

impl Options {
    fn load(self, extensions: &Extensions) -> std::result::Result<opspace_experiment::Experiment, FileError> {
        let files = Files::Disk;
        let (robot_settings, task_settings) = overrides::split(&self.settings, ROBOT);
        let task = match self.task {
            Part::Path(path) => TaskDefinition::load_with(extensions, files, &path, &task_settings)?,
            Part::Dictionary(mut table) => {
                if self.robot.is_some() {
                    table.entry(ROBOT).or_insert_with(|| Value::String(".".to_owned()));
                }
                let source = source(TASK, &table)?;
                Kind::Task.require(&source)?;
                let source = overrides::apply(&source, &task_settings)?;
                TaskDefinition::from_sources_with(extensions, source, |named| files.read(&named.path))?
            }
        };
        let robot = match self.robot {
            Some(Part::Path(path)) => RobotDefinition::load(files, &path, &robot_settings)?,
            Some(Part::Dictionary(table)) => {
                let source = source(ROBOT, &table)?;
                Kind::Robot.require(&source)?;
                let source = overrides::apply_below(&source, ROBOT, &robot_settings)?;
                let urdf = table.get("urdf").and_then(Value::as_str).unwrap_or_default();
                RobotDefinition::from_sources(
                    source.clone(),
                    files.read_named(Path::new(urdf), &source, "urdf")?,
                )?
            }
            None => {
                let path = task.robot_path();
                files.read_named(&files.robot_file(&path), &task.source, ROBOT)?;
                RobotDefinition::load(files, &path, &robot_settings)?
            }
        };
        let backend = self.backend.unwrap_or(robot.file.interface.command);
        let options = RunOptions { backend, ..self.options };
        opspace_experiment::Experiment::new(robot, task, options, self.settings)
    }
}

#[pymethods]
impl Experiment {
    #[new]
    #[pyo3(signature = (task, robot=None, *, backend=None, controller=None, transformer=None, profile=None, set=None,
        seed=None, duration_s=None, allow=None, tasks=None, metrics=None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn new(
        py: Python<'_>,
        task: &Bound<'_, PyAny>,
        robot: Option<&Bound<'_, PyAny>>,
        backend: Option<&str>,
        controller: Option<&str>,
        transformer: Option<String>,
        profile: Option<String>,
        set: Option<&Bound<'_, PyAny>>,
        seed: Option<u64>,
        duration_s: Option<f64>,
        allow: Option<Vec<String>>,
        tasks: Option<&Bound<'_, PyDict>>,
        metrics: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let entries = Entries::new(tasks, metrics)?;
        let task = Part::new(TASK, task)?;
        let robot = robot.map(|robot| Part::new(ROBOT, robot)).transpose()?;
        let parts = [(TASK, Some(&task)), (ROBOT, robot.as_ref())].into_iter();
        let is_dictionary = |part: Option<&Part>| matches!(part, Some(Part::Dictionary(_)));
        let dictionaries: Vec<_> =
            parts.filter(|(_, part)| is_dictionary(*part)).map(|(name, _)| name).collect();
        let kinds = CommandKind::ALL.map(|kind| (kind.name(), kind));
        let backend = backend.map(|name| one_of("backend", name, &kinds)).transpose()?;
        let kinds = ControllerKind::ALL.map(|kind| (kind.name(), kind));
        let controller = controller.map(|name| one_of("controller", name, &kinds)).transpose()?;
        if duration_s.is_some_and(|duration_s| !(duration_s > 0.0 && duration_s.is_finite())) {
            return Err(argument("duration_s", "expected a positive number"));
        }
        let allow = allow.unwrap_or_default();
        let allow = allow.iter().map(|code| code.parse::<Code>().map_err(|error| argument("allow", &error)));
        let options = RunOptions {
            controller: controller.unwrap_or(ControllerKind::Osc),
            transformer: transformer.map(TransformerName::from),
            profile,
            seed,
            duration_s,
            allow: allow.collect::<PyResult<_>>()?,
            ..RunOptions::default()
        };
        let settings = set.map(settings).transpose()?.unwrap_or_default();
        let options = Options { task, robot, backend, options, settings };
        let loaded = py.detach(|| caught(|| Ok::<_, PyErr>(options.load(&entries.extensions()?))))??;
        let experiment = loaded.map_err(|error| of_file(&error, &dictionaries))?;
        Ok(Self { experiment: Arc::new(experiment), dictionaries, entries })
    }

    /// Name of the task.
    #[getter]
    fn task(&self) -> String {
        self.experiment.task().name()
    }

    /// Name of the robot.
    #[getter]
    fn robot(&self) -> String {
        self.experiment.robot().name()
    }

    /// Command that the robot accepts: "position", "velocity" or "torque".
    #[getter]
    fn backend(&self) -> &'static str {
        self.experiment.command_kind().name()
    }

    /// Controller: "osc", "ik" or "ik-lead".
    #[getter]
    fn controller(&self) -> &'static str {
        self.experiment.options().controller.name()
    }

    /// Transformer of torques to commands; None if the robot accepts torques or the controller commands positions.
    #[getter]
    fn transformer(&self) -> Option<String> {
        self.experiment.transformer_name().map(|name| name.to_string())
    }

    /// Seed of all random numbers.
    #[getter]
    fn seed(&self) -> u64 {
        self.experiment.seed()
    }

    /// Duration of control, s.
    #[getter]
    fn duration_s(&self) -> f64 {
        self.experiment.duration_s()
    }

    /// Period of a control cycle, s.
    #[getter]
    fn period_s(&self) -> f64 {
        self.experiment.profile().1.period_s()
    }

    /// Names of the joints, in the order of q (n).
    #[getter]
    fn joints(&self) -> Vec<String> {
        self.experiment.robot().model.joints().iter().map(|joint| joint.name.clone()).collect()
    }

    /// Quantities that the robot measures: "position", and "velocity", "motor-current" and "joint-torque" if robot.toml declares them.
    #[getter]
    fn measured(&self) -> Vec<&'static str> {
        let capabilities = self.experiment.capabilities();
        let optional = [
            ("velocity", capabilities.measures_velocity),
            ("motor-current", capabilities.measures_motor_torque),
            ("joint-torque", capabilities.measures_joint_torque),
        ];
        let measured = optional.into_iter().filter(|(_, is_measured)| *is_measured);
        std::iter::once("position").chain(measured.map(|(name, _)| name)).collect()
    }

    /// Model of the robot, as the controller uses it.
    #[getter]
    fn model(&self) -> Model {
        Model::of_robot(self.experiment.robot())
    }

    /// Returns the problems that `opspace check` predicts; most experiments have none.
    fn check(&self, py: Python<'_>) -> PyResult<Vec<Finding>> {
        let experiment = &self.experiment;
        let found = py.detach(|| caught(|| problems(&Extensions::default(), experiment)))?;
        Ok(found.into_iter().map(|finding| Finding::new(finding, experiment)).collect())
    }

    /// Runs the experiment in simulation, without Python's lock.
    ///
    /// log: path of a log to write; with overwrite, an existing file is replaced. folder: path of a folder for log, summary and
    /// page, which must not contain a log yet. Without either, the log is kept in memory, some 0.5 MB per second of a run.
    ///
    /// A fault of the robot is no exception: it ends the run, and `Result.fault` has it. Ctrl-C stops the robot in its next
    /// cycle; the log is closed, files are complete, and KeyboardInterrupt is raised.
    ///
    /// Raises OpspaceError for a robot that cannot be simulated, or a file that cannot be written.
    #[pyo3(signature = (log=None, folder=None, *, overwrite=false))]
    fn run(
        &self,
        py: Python<'_>,
        log: Option<PathBuf>,
        folder: Option<PathBuf>,
        overwrite: bool,
    ) -> PyResult<Result> {
        if log.is_some() && folder.is_some() {
            return Err(argument("folder", "give either log or folder: a folder has a log of its own"));
        }
        let (experiment, progress) = (&*self.experiment, Progress::default());
        let ran = interruptible(py, &progress, || {
            let place = match (log, folder) {
                (Some(path), _) => Output::File(create(&path, overwrite)?, path),
                (_, Some(folder)) => Output::Folder(folder),
                (None, None) => Output::Memory,
            };
            run(experiment, place, &progress)
        })?;
        self.result(ran)
    }

    /// Returns the control loop before its first cycle: Python steps it, with measurements of a robot of its own.
    fn control_loop(&self) -> PyResult<ControlLoop> {
        ControlLoop::new(Arc::clone(&self.experiment))
    }

    /// Returns control loops for `count` robots, which are stepped in one call.
    fn control_loops(&self, py: Python<'_>, count: usize) -> PyResult<ControlLoops> {
        py.detach(|| ControlLoops::new(Arc::clone(&self.experiment), count))
    }

    /// Returns the simulated robot at rest at its start, on which external forces can act.
    ///
    /// start: positions of the joints, rad or m (n); None is the start of the task.
    ///
    /// Raises OpspaceError for a robot that cannot be simulated.
    #[pyo3(signature = (start=None))]
    fn simulation(&self, py: Python<'_>, start: Option<&Bound<'_, PyAny>>) -> PyResult<Simulation> {
        let mut q = vec![0.0; self.experiment.robot().model.n()];
        let start = start.map(|start| vector("start", start, &mut q).map(|()| q)).transpose()?;
        py.detach(|| Simulation::new(&self.experiment, start))
    }

    /// Starts a run that Python steps, with a log: in memory, or the file at `log`. With `simulation`, its true state is logged.
    ///
    /// Raises OpspaceError for a log that cannot be written.
    #[pyo3(signature = (log=None, *, simulation=None, overwrite=false))]
    fn start(&self, log: Option<PathBuf>, simulation: Option<&Simulation>, overwrite: bool) -> PyResult<Run> {
        let sink = match &log {
            Some(path) => {
                let file = create(path, overwrite).map_err(|error| of_run(&error, &self.dictionaries))?;
                LogSink::File(BufWriter::new(file))
            }
            None => LogSink::Memory(Vec::new()),
        };
        Run::new(Arc::clone(&self.experiment), self.entries.clone(), sink, log.map(absolute), simulation)
    }

    /// Runs the experiment on a robot that is written in Python, and returns its result.
    ///
    /// robot: an object with three methods. `read()` waits for the next cycle and returns a dictionary of the arguments of
    /// `ControlLoop.step`: `time_s`, `q` and what else robot.toml declares as measured. `write(kind, values)` sends a command:
    /// "position", "velocity" or "torque" with an array (n), or "hold" with None. `stop()` brings the robot to its safe state; it may
    /// be called twice.
    ///
    /// real: True for a robot of the real world. It must then be at the start of the task, rows that the disk is too slow for are
    /// dropped and counted, and samples that come late by the computer's clock stop it. A cycle takes Python's time. log, overwrite
    /// and Ctrl-C are those of `run`.
    ///
    /// Ctrl-C reaches Python's main thread alone: call `on` there. A stop waits for `read` and `write` to return. Objects of the task's
    /// environment are not simulated here. An exception of a method stops the robot; it is raised with its traceback once the log is closed.
    #[pyo3(signature = (robot, log=None, *, real=false, overwrite=false))]
    fn on(
        &self,
        py: Python<'_>,
        robot: &Bound<'_, PyAny>,
        log: Option<PathBuf>,
        real: bool,
        overwrite: bool,
    ) -> PyResult<Result> {
        let (experiment, progress) = (&*self.experiment, Progress::default());
        let declared = experiment.capabilities();
        let capabilities = if real { declared } else { declared.simulated() };
        let mut backend = PythonRobot::new(robot, capabilities)?;
        let on = &mut backend;
        let ran = interruptible(py, &progress, || match log {
            Some(path) => {
                let file = create(&path, overwrite)?;
                in_file(experiment, path, |log| experiment.run_on(on, log, &progress), file)
            }
            None => in_memory(experiment, |log| experiment.run_on(on, log, &progress)),
        });
        if let Some(raised) = backend.into_raised() {
            return Err(raised);
        }
        self.result(ran?)
    }

    fn __repr__(&self) -> String {
        let by = self.transformer().map_or_else(String::new, |name| format!(", transformer '{name}'"));
        format!(
            "Experiment('{}' on {} robot '{}', controller '{}'{by}, seed {}, {} s)",
            self.task(),
            self.backend(),
            self.robot(),
            self.controller(),
            self.seed(),
            self.duration_s()
        )
    }

    /// Returns function and arguments that build the experiment again, from the texts of its files and its options.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py>> {
        let bytes = bytes_of(&self.experiment)?;
        let build = py.import("opspace._opspace")?.getattr("_experiment_of_bytes")?;
        let [tasks, metrics] = self.entries.dictionaries(py);
        Ok((build, (PyBytes::new(py, &bytes), self.dictionaries.clone(), tasks, metrics)))
    }
}

impl Experiment {
    /// Returns the object of an experiment that has been read.
    pub(crate) fn of(experiment: Arc<opspace_experiment::Experiment>, entries: Entries) -> Self {
        Self { experiment, dictionaries: Vec::new(), entries }
    }

    /// Returns the result of a run.
    fn result(&self, ran: std::result::Result<Ran, RunError>) -> PyResult<Result> {
        let (summary, outcome, log) = ran.map_err(|error| of_run(&error, &self.dictionaries))?;
        let fault = match outcome {
            Some(RunOutcome::Faulted { fault, time_s }) => {
                Some(FaultText::new(&fault, time_s, &self.experiment.robot().model))
            }
            _ => None,
        };
        Result::new(Arc::clone(&self.experiment), self.entries.clone(), summary, fault, log)
    }
}

/// Returns an experiment as the bytes of a log without rows: it has the texts of all files and the options.
pub(crate) fn bytes_of(experiment: &opspace_experiment::Experiment) -> PyResult<Vec<u8>> {
    let progress = Progress::default();
    let sink = Cursor::new(Vec::new());
    let written = caught(|| {
        let (_, log) = experiment.open(&experiment.capabilities().simulated(), None, sink, &progress)?;
        log.close(experiment, RunOutcome::Completed)
    })?;
    Ok(written.map_err(|error| of_run(&error, &[]))?.sink.into_inner())
}

/// Builds an experiment from the bytes of [`bytes_of`].
pub(crate) fn of_bytes(bytes: &[u8], entries: &Entries) -> PyResult<opspace_experiment::Experiment> {
    let extensions = entries.extensions()?;
    let read = || opspace_experiment::Experiment::of_log_with(&extensions, &Recording::from_bytes(bytes)?);
    caught(read)?.map_err(|error| of_run(&error, &[]))
}

/// Builds a pickled experiment.
#[pyfunction]
#[pyo3(name = "_experiment_of_bytes")]
pub(crate) fn experiment_of_bytes(
    py: Python<'_>,
    bytes: &[u8],
    dictionaries: Vec<String>,
    tasks: Option<&Bound<'_, PyDict>>,
    metrics: Option<&Bound<'_, PyDict>>,
) -> PyResult<Experiment> {
    let entries = Entries::new(tasks, metrics)?;
    let experiment = py.detach(|| of_bytes(bytes, &entries))?;
    let is_dictionary = |name: &&str| dictionaries.iter().any(|dictionary| dictionary == name);
    let dictionaries = [TASK, ROBOT].into_iter().filter(is_dictionary).collect();
    Ok(Experiment { experiment: Arc::new(experiment), dictionaries, entries })
}

/// Place of the log of a run.
enum Output {
    Memory,
    File(File, PathBuf),
    Folder(PathBuf),
}

fn create(path: &Path, overwrite: bool) -> std::result::Result<File, RunError> {
    let mut options = File::options();
    options.write(true);
    if overwrite {
        options.create(true).truncate(true)
    } else {
        options.create_new(true)
    };
    options.open(path).map_err(|source| RunError::Write { path: path.to_owned(), source })
}

/// Summary, outcome and log of a run.
type Ran = (Summary, Option<RunOutcome>, StoredLog);

/// Runs an experiment by `run` with a log in memory.
fn in_memory(
    experiment: &opspace_experiment::Experiment,
    run: impl FnOnce(Cursor<Vec<u8>>) -> std::result::Result<RunResult<Cursor<Vec<u8>>>, RunError>,
) -> std::result::Result<Ran, RunError> {
    let run = run(Cursor::new(Vec::new()))?;
    let recording = Recording::from_bytes(run.sink.get_ref())?;
    let summary = experiment.summary(&recording, &run.record, Some(run.realtime_factor));
    Ok((summary, Some(run.outcome), StoredLog::Bytes(run.sink.into_inner().into())))
}

/// Runs an experiment by `run` with a log in `file`, which is at `path`.
fn in_file(
    experiment: &opspace_experiment::Experiment,
    path: PathBuf,
    run: impl FnOnce(BufWriter<File>) -> std::result::Result<RunResult<BufWriter<File>>, RunError>,
    file: File,
) -> std::result::Result<Ran, RunError> {
    let run = run(BufWriter::new(file))?;
    let mut sink = run.sink;
    sink.flush().map_err(|source| RunError::Write { path: path.clone(), source })?;
    drop(sink);
    let log = opspace_log::LogFile::open(&path)?;
    let summary = experiment.summary_of_file(&log, &run.record, Some(run.realtime_factor))?;
    Ok((summary, Some(run.outcome), StoredLog::Path(absolute(path))))
}

/// Runs an experiment in simulation.
fn run(
    experiment: &opspace_experiment::Experiment,
    output: Output,
    progress: &Progress,
) -> std::result::Result<Ran, RunError> {
    match output {
        Output::Memory => in_memory(experiment, |log| experiment.run(log, progress)),
        Output::File(file, path) => in_file(experiment, path, |log| experiment.run(log, progress), file),
        Output::Folder(folder) => {
            let mut outcome = None;
            let summary = in_folder(experiment, &folder, |log| {
                let run = experiment.run(log, progress)?;
                outcome = Some(run.outcome.clone());
                Ok(run)
            })?;
            let path = folder.join(opspace_experiment::run::result_files::LOG);
            Ok((summary, outcome, StoredLog::Path(absolute(path))))
        }
    }
}

/// Path that stays valid if the working folder changes.
fn absolute(path: PathBuf) -> PathBuf {
    std::path::absolute(&path).unwrap_or(path)
}

/// Value of a name among some.
fn one_of<T: Copy>(argument_name: &str, name: &str, known: &[(&str, T)]) -> PyResult<T> {
    known.iter().find(|(known, _)| *known == name).map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<String> = known.iter().map(|(name, _)| format!("'{name}'")).collect();
        argument(argument_name, &format!("expected {}, got '{name}'", names.join(", ")))
    })
}

/// Settings: a sequence of texts, or a dictionary of keys and values.
fn settings(set: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
    if let Ok(dictionary) = set.cast::<PyDict>() {
        return dictionary
            .iter()
            .map(|(key, object)| {
                let key: String = key.extract().map_err(|_| argument("set", "a key is not a text"))?;
                let value = value(&key, &object)?;
                // Tables are written in one line.
                Ok(format!("{key}={}", inline(&value)))
            })
            .collect();
    }
    if set.is_instance_of::<PyString>() {
        return Err(argument("set", "expected a sequence of \"key=value\" or a dictionary, got one text"));
    }
    set.extract().map_err(|_| argument("set", "expected a sequence of \"key=value\" or a dictionary"))
}

/// Text of a value in one line.
fn inline(value: &Value) -> String {
    match value {
        Value::Table(table) => {
            let entry = |(key, value): (&String, &Value)| {
                format!("{} = {}", Value::String(key.clone()), inline(value))
            };
            format!("{{ {} }}", table.iter().map(entry).collect::<Vec<_>>().join(", "))
        }
        Value::Array(values) => format!("[{}]", values.iter().map(inline).collect::<Vec<_>>().join(", ")),
        plain => plain.to_string(),
    }
}

/// Problem that is predicted before a run.
#[pyclass(frozen, get_all, module = "opspace")]
pub(crate) struct Finding {
    /// Kind of the problem; `opspace explain CODE` describes it.
    code: String,
    /// Name of the file with the value at fault; None if the problem is not about a value.
    file: Option<String>,
    /// Key of the value at fault, dotted; None if the problem is not about a value.
    key: Option<String>,
    /// Description, with the numbers and the causes.
    message: String,
    /// Remedy; empty if the page of the code has the only one.
    help: String,
    /// Numbers of the problem, by names that end with their units.
    numbers: BTreeMap<String, f64>,
}

impl Finding {
    fn new(finding: opspace_experiment::Finding, experiment: &opspace_experiment::Experiment) -> Self {
        let key = Some(finding.key().to_owned()).filter(|key| !key.is_empty());
        let source = match finding.place {
            Place::RobotFile(_) => &experiment.robot().source,
            _ => &experiment.task().source,
        };
        Self {
            code: finding.code.to_string(),
            file: key.is_some().then(|| source.name().to_owned()),
            key,
            message: finding.message,
            help: finding.help,
            numbers: finding.numbers,
        }
    }
}

#[pymethods]
impl Finding {
    fn __str__(&self) -> String {
        format!("[{}] {}", self.code, self.message)
    }

    fn __repr__(&self) -> String {
        format!("Finding({})", self.__str__())
    }
}
