//! Scenario: one robot or several, each with its own task, backend, rate and log, on one clock.
//!
//! A task file describes a scenario of one robot. The file of an experiment with several robots couples their tasks through
//! channels: a robot sees the others only through links; what it received is in its own log, so that each log can be
//! replayed alone.

use crate::codes::{AllowedRefusal, Code};
use crate::extensions::Extensions;
use crate::files::controller_kind::ControllerKind;
use crate::files::expectation::Expectation;
use crate::files::experiment_file::{ExperimentFile, ExperimentRobot};
use crate::files::mount::MountFile;
use crate::files::origin::{Files, Kind, beside};
use crate::files::overrides;
use crate::files::source::{FileError, Source, checked, parse};
use crate::files::toml_path::{depth_of, dotted};
use crate::run::companion::Companion;
use crate::run::coupling_expectations::check_expectations;
use crate::run::couplings::{Coupling, SEEDS_OF_A_SCENARIO, couplings, links, task_settings};
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::experiment::{Experiment, RunOptions};
use crate::run::member::Member;
use crate::run::membership::Membership;
use crate::transformers::check_name;
use opspace_backend::{Backend, Capabilities, CommandKind, GroundTruth, Sink, TruthLayouts};
use opspace_log::ViewerReceiver;
use opspace_loop::{
    ControlLoop, Driven, RealTimeParameters, Run, RunOutcome, Timeline, TimelineError, drive_together_with,
};
use opspace_sim::{
    ArmConfig, HeldObjectConfig, HeldObjectParameters, Key, PhysicsEngine, SimulatedArm, SimulationConfig,
    SimulationError,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// One robot or several with their tasks, read from files and checked.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Text of the file, with settings applied: of one robot, its task file.
    pub source: Source,
    /// Robots, in the order of their names.
    pub members: Vec<Member>,
    /// Couplings, in the order of their names; none with one robot.
    pub couplings: Vec<Coupling>,
    /// Objects that hands of the robots hold, by name; all robots are then in one plant.
    pub objects: BTreeMap<String, HeldObjectParameters>,
    /// Bounds on metrics of the couplings.
    pub(crate) expect: BTreeMap<String, Expectation>,
    /// Start of the statistics of the couplings, s after the start of control.
    pub settle_s: f64,
    /// Seed of all random numbers.
    pub(crate) seed: u64,
    /// Settings with which it was loaded; with several robots, without that of the seed.
    pub settings: Vec<String>,
    /// Name of the settings in the table of a suite.
    pub label: Option<String>,
}

impl From<Experiment> for Scenario {
    /// Returns the scenario of one robot.
    fn from(experiment: Experiment) -> Self {
        Self {
            source: experiment.task().source.clone(),
            couplings: Vec::new(),
            objects: BTreeMap::new(),
            expect: BTreeMap::new(),
            settle_s: experiment.task().file.settle_s.get(),
            seed: experiment.seed(),
            settings: experiment.settings().to_vec(),
            label: experiment.options().label.clone(),
            members: vec![Member::alone(experiment)],
        }
    }
}

impl Scenario {
    /// Names of the robots that are real, because their robot.toml selects a driver.
    #[must_use]
    pub fn real_robots(&self) -> Vec<&str> {
        let real = self.members.iter().filter(|member| member.experiment.has_driver());
        real.map(|member| member.name.as_str()).collect()
    }

    /// Reads a task file for one robot, as [`Experiment::load_with`] does, or the file of an experiment with several robots, as
    /// [`load_robots`](Self::load_robots) does. `backend` replaces the command interface of robot.toml, and `options.backend`
    /// is not used. Of the options, an experiment takes profile, seed, duration, label and allowed refusals; its file states
    /// all else for each robot.
    ///
    /// # Errors
    /// Mistakes in any of the files, and contradictions between them, each with its place.
    pub fn load(
        extensions: &Extensions,
        files: Files,
        path: &Path,
        robot: Option<&Path>,
        backend: Option<CommandKind>,
        options: RunOptions,
        settings: &[String],
    ) -> Result<Self, FileError> {
        let has_several = files.kind(path) == Some(Kind::Experiment);
        Self::load_as(has_several, (extensions, files), (path, robot), backend, options, settings)
    }

    /// Reads the file of an experiment with several robots or a task file, as [`load`](Self::load) does, whatever the file is.
    pub fn load_as(
        has_several: bool,
        (extensions, files): (&Extensions, Files),
        (path, robot): (&Path, Option<&Path>),
        backend: Option<CommandKind>,
        options: RunOptions,
        settings: &[String],
    ) -> Result<Self, FileError> {
        if has_several {
            let RunOptions { profile, seed, duration_s, label, allow, .. } = options;
            let mut set = Vec::new();
            if let Some(profile) = profile {
                set.extend(robot_names(&files.read(path)?)?.into_iter().map(|robot| {
                    format!("{}=\"{profile}\"", dotted(&["robots".to_owned(), robot, "profile".to_owned()]))
                }));
            }
            set.extend_from_slice(settings);
            set.extend(seed.map(|seed| format!("seed={seed}")));
            set.extend(duration_s.map(|duration_s| format!("duration_s={duration_s}")));
            return Ok(Self { label, ..Self::load_robots(extensions, files, path, &set, &allow)? });
        }
        Ok(of_task(extensions, files, (path, robot), backend, options, settings)?.into())
    }

    /// Reads an experiment with several robots and all files that it names, and allows refusals with the codes in `allow`.
    /// Settings that begin with the name of a robot and a dot are settings of this robot
    /// (`leader.task.hand.coupled.damping_ns_per_m=5`), all others change the file of the experiment.
    ///
    /// # Errors
    /// Mistakes in any of the files, and contradictions between them, each with its place.
    pub fn load_robots(
        extensions: &Extensions,
        files: Files,
        path: &Path,
        settings: &[String],
        allow: &[Code],
    ) -> Result<Self, FileError> {
        let source = files.read(path)?;
        let names = robot_names(&source)?;
        let mut of_robots: BTreeMap<String, Vec<String>> = BTreeMap::new();
        let mut own = settings.to_vec();
        for name in &names {
            let (of_robot, others) = overrides::split(&own, name);
            own = others;
            let stripped = of_robot.iter().map(|set| set.trim_start()[name.len() + 1..].to_owned());
            of_robots.insert(name.clone(), stripped.collect());
        }
        let source = overrides::apply(&source, &own)?;
        let file: ExperimentFile = parse(&source)?;
        let is_plain = |name: &str| name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        if let Some(name) = file.robots.keys().find(|name| name.is_empty() || !is_plain(name)) {
            let message = format!("robot name '{name}': only letters, digits, '_' and '-' are allowed");
            return Err(FileError::at_key(&source, ["robots", name], message, None));
        }
        if file.robots.len() < 2 {
            let help = Some("add another robot; a task of one robot needs no file of this kind".to_owned());
            return Err(FileError::at_key(&source, "robots", "at least two robots are needed", help));
        }
        let couplings = couplings(&file, &source)?;
        let is_seed = |set: &&String| set.split('=').next().is_some_and(|key| key.trim() == "seed");
        let kept: Vec<String> = settings.iter().filter(|set| !is_seed(set)).cloned().collect();
        let mut members = Vec::new();
        for (number, (name, robot)) in file.robots.iter().enumerate() {
            let base = stated_base(&source, name, robot)?;
            let mut set: Vec<String> =
                base.iter().map(|(_, mount)| format!("{MOUNT}={}", mount.toml())).collect();
            set.extend_from_slice(&robot.set);
            set.push(format!("settle_s={}", file.settle_s.get()));
            for coupling in &couplings {
                set.extend(task_settings(&source, coupling, number));
            }
            set.extend(of_robots.remove(name).unwrap_or_default());
            if let Some(transformer) = &robot.transformer {
                check_name(extensions, transformer, &source, ["robots", name, "transformer"])?;
            }
            let options = (seed_of(&file, number), allow);
            let mut experiment = member(extensions, files, path, robot, &set, options, &file)
                .map_err(|error| placed(error, &source, &couplings, (number, name), &robot.set))?;
            if let Some((key, _)) = base {
                refuse_second_mount(&source, (name, key), &experiment, &set[1..])?;
            }
            experiment.membership =
                Some(Membership { robot: name.clone(), experiment: source.clone(), settings: kept.clone() });
            members.push(Member::new(name, experiment, &source)?);
        }
        let mut new = Self::of_robots(source, file, members, couplings, kept);
        for coupling in &new.couplings {
            coupling.check_rows(&new.members, &new.source)?;
        }
        new.refuse_couplings()?;
        if !new.objects.is_empty() {
            new.simulated_arms()?;
        }
        let names: Vec<&str> = new.couplings.iter().map(|coupling| coupling.name.as_str()).collect();
        check_expectations(&new.source, &new.expect, &names)?;
        Ok(new)
    }

    /// Combines the robots of the file in `source`.
    pub(super) fn of_robots(
        source: Source,
        file: ExperimentFile,
        members: Vec<Member>,
        couplings: Vec<Coupling>,
        settings: Vec<String>,
    ) -> Self {
        let ExperimentFile { objects, expect, settle_s, seed, .. } = file;
        Self {
            source,
            members,
            couplings,
            objects,
            expect,
            settle_s: settle_s.get(),
            seed,
            settings,
            label: None,
        }
    }

    /// Combines several robots, with their names, that run side by side without couplings, for comparison.
    ///
    /// # Errors
    /// A robot whose rate is not a whole number of hertz.
    pub fn beside(robots: Vec<(String, Experiment)>) -> Result<Self, FileError> {
        let members = robots.into_iter().map(|(name, experiment)| {
            let source = experiment.task().source.clone();
            Member::new(&name, experiment, &source)
        });
        let members = members.collect::<Result<Vec<_>, _>>()?;
        let first = members.first().map(|member| Self::from(member.experiment.clone()));
        let first = first.ok_or_else(|| FileError::of_file("", "at least one robot is needed", None))?;
        Ok(Self { members, ..first })
    }

    /// Experiment of the robot, if there is only one.
    #[must_use]
    pub fn single(&self) -> Option<&Experiment> {
        match self.members.as_slice() {
            [member] => Some(&member.experiment),
            _ => None,
        }
    }

    /// Experiments of all robots, in their order.
    pub fn experiments(&self) -> impl Iterator<Item = &Experiment> {
        self.members.iter().map(|member| &member.experiment)
    }

    /// Refusals that the user has allowed, each once.
    #[must_use]
    pub fn allowed(&self) -> Vec<&AllowedRefusal> {
        let mut all: Vec<&AllowedRefusal> = Vec::new();
        for refusal in self.experiments().flat_map(Experiment::allowed) {
            if !all.contains(&refusal) {
                all.push(refusal);
            }
        }
        all
    }

    /// Plant of the simulation.
    #[must_use]
    pub fn plant(&self) -> String {
        self.members.first().map_or_else(String::new, |member| member.experiment.plant())
    }

    /// Name of the scenario: the name of its file without extension.
    #[must_use]
    pub fn name(&self) -> String {
        let stem = Path::new(self.source.name()).file_stem();
        stem.map_or_else(|| self.source.name().to_owned(), |s| s.to_string_lossy().into_owned())
    }

    /// Duration of control, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.members.first().map_or(0.0, |member| member.experiment.duration_s())
    }

    /// Number of interface cycles of all robots in a complete run, with the rest before control starts.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.experiments().map(Experiment::ticks).sum()
    }

    /// Paths of the files from which the experiment was read.
    #[must_use]
    pub fn input_paths(&self) -> Vec<PathBuf> {
        let of_members = self.experiments().flat_map(Experiment::input_paths);
        of_members.chain([self.source.name().into()]).collect()
    }

    /// Returns the scenario with all robots on another plant.
    ///
    /// # Errors
    /// A robot that the engine cannot simulate.
    pub fn on_engine(mut self, engine: &Arc<dyn PhysicsEngine>) -> Result<Self, FileError> {
        for member in &mut self.members {
            member.experiment = member.experiment.clone().on_engine(Arc::clone(engine))?;
        }
        Ok(self)
    }

    /// Runs the scenario in simulation. `open` gets the number of a robot, its capabilities and the layouts of its true state,
    /// and returns its control loop and its sink; the sinks and outcomes are returned in the order of the robots.
    ///
    /// # Errors
    /// A robot that cannot be simulated, and the errors of `open`.
    pub fn drive<S: Sink>(
        &self,
        progress: &Progress,
        open: impl FnMut(usize, &Capabilities, Option<TruthLayouts>) -> Result<(ControlLoop, S), RunError>,
    ) -> Result<Vec<(S, RunOutcome)>, RunError> {
        let mut arms = self.simulated_arms()?;
        let mut robots: Vec<&mut dyn Backend> = arms.iter_mut().map(|arm| arm as &mut dyn Backend).collect();
        self.drive_robots(&mut robots, progress, open)
    }

    /// Runs the scenario on these robots, in their order, as [`drive`](Self::drive) does.
    pub fn drive_robots<S: Sink>(
        &self,
        robots: &mut [&mut dyn Backend],
        progress: &Progress,
        mut open: impl FnMut(usize, &Capabilities, Option<TruthLayouts>) -> Result<(ControlLoop, S), RunError>,
    ) -> Result<Vec<(S, RunOutcome)>, RunError> {
        let open = |number, capabilities: &Capabilities, truth, _| open(number, capabilities, truth);
        self.drive_robots_with(robots, progress, &mut (), open)
    }

    /// Runs the scenario on these robots as [`drive_robots`](Self::drive_robots) does, with a companion. `open` gets its receivers too.
    pub fn drive_robots_with<S: Sink>(
        &self,
        robots: &mut [&mut dyn Backend],
        progress: &Progress,
        companion: &mut dyn Companion,
        mut open: impl FnMut(
            usize,
            &Capabilities,
            Option<TruthLayouts>,
            Vec<Box<dyn ViewerReceiver>>,
        ) -> Result<(ControlLoop, S), RunError>,
    ) -> Result<Vec<(S, RunOutcome)>, RunError> {
        let mut loops = Vec::new();
        let mut sinks = Vec::new();
        let mut periods_s = Vec::new();
        for (number, robot) in robots.iter().enumerate() {
            let truth = robot.ground_truth().map(GroundTruth::layouts);
            periods_s.push(robot.capabilities().period_s);
            let (control, sink) = open(number, robot.capabilities(), truth, companion.receivers(number))?;
            loops.push(control);
            sinks.push(sink);
        }
        let mut real_time = None;
        for (experiment, robot) in self.experiments().zip(robots.iter()) {
            real_time = stricter(real_time, experiment.real_time(robot.capabilities())?);
        }
        let mut before = |robot: usize, cycle: u64, run: &mut Run<'_>| {
            companion.before_cycle(robot, cycle as f64 * periods_s[robot], run)
        };
        let rates: Vec<u32> = self.members.iter().map(|member| member.rate_hz).collect();
        let mistake =
            |error: TimelineError| FileError::at_key(&self.source, "robots", error.to_string(), None);
        let mut timeline = Timeline::new(&rates).map_err(mistake)?;
        let mut links = links((&self.source, self.seed), &self.couplings, &timeline, &loops)?;
        let mut runs: Vec<Run<'_>> = loops
            .into_iter()
            .zip(&mut sinks)
            .map(|(control, sink)| {
                Run::new(control, self.duration_s(), sink)
                    .with_stop_request(Arc::clone(&progress.interrupt))
                    .with_abort_request(Arc::clone(&progress.abort))
            })
            .collect();
        let mut driven: Vec<Driven<'_, '_>> = robots
            .iter_mut()
            .zip(&mut runs)
            .map(|(robot, run)| Driven { backend: &mut **robot, run })
            .collect();
        progress.driving_in_real_time(real_time, || {
            drive_together_with(&mut driven, &mut links, &mut timeline, &mut before);
        })?;
        drop(driven);
        let outcomes: Vec<RunOutcome> = runs.into_iter().map(Run::finish).collect();
        Ok(sinks.into_iter().zip(outcomes).collect())
    }

    /// Arms of the simulation: each in a plant of its own, or all in one if hands hold an object.
    pub fn simulated_arms(&self) -> Result<Vec<SimulatedArm>, FileError> {
        self.arms(false)
    }

    /// Arms of the simulation as [`simulated_arms`](Self::simulated_arms), on which a program may apply external forces.
    pub fn pushable_arms(&self) -> Result<Vec<SimulatedArm>, FileError> {
        self.arms(true)
    }

    fn arms(&self, external_forces: bool) -> Result<Vec<SimulatedArm>, FileError> {
        let config = |experiment: &Experiment| {
            experiment.arm_config().map(|config| ArmConfig { external_forces, ..config })
        };
        if self.objects.is_empty() {
            let arm = |experiment: &Experiment| experiment.simulated_arm_of(config(experiment)?);
            return self.experiments().map(arm).collect();
        }
        let names: Vec<String> = self.members.iter().map(|member| member.name.clone()).collect();
        let arms = self.experiments().map(config);
        let objects = self.objects.iter().map(|(name, object)| HeldObjectConfig {
            name: name.clone(),
            arms: names.clone(),
            parameters: object.clone(),
        });
        let config = SimulationConfig {
            arms: arms.collect::<Result<_, FileError>>()?,
            couplings: Vec::new(),
            objects: objects.collect(),
        };
        let simulation = self.members[0].experiment.simulation_of(config);
        Ok(simulation.map_err(|error| self.simulation_mistake(&error))?.into_arms())
    }

    fn simulation_mistake(&self, error: &SimulationError) -> FileError {
        match error.key() {
            Key::Simulation(key) => FileError::at_key(&self.source, key, error.to_string(), None),
            _ => FileError::of_file(self.source.name(), error.to_string(), None),
        }
    }

    /// Refuses couplings, or records each refusal with both robots of the coupling if the user allows its code.
    fn refuse_couplings(&mut self) -> Result<(), FileError> {
        let Self { couplings, members, source, .. } = self;
        let refusals = couplings.iter().flat_map(|coupling| {
            let ends = [coupling.leader.0, coupling.follower.0];
            coupling.refusals(members, source).into_iter().map(move |refusal| (ends, refusal))
        });
        for (ends, refusal) in refusals.collect::<Vec<_>>() {
            for robot in ends {
                members[robot].experiment.refuse(refusal.clone())?;
            }
        }
        Ok(())
    }
}

/// Scheduling of a thread that drives two robots: the stricter request, and the higher priority.
fn stricter(
    one: Option<RealTimeParameters>,
    other: Option<RealTimeParameters>,
) -> Option<RealTimeParameters> {
    let (Some(a), Some(b)) = (one, other) else { return one.or(other) };
    Some(a.with_mode(a.mode.max(b.mode)).with_priority(a.priority.max(b.priority)))
}

fn robot_names(source: &Source) -> Result<Vec<String>, FileError> {
    Kind::Experiment.require(source)?;
    Ok(parse::<ExperimentFile>(source)?.robots.into_keys().collect())
}

fn seed_of(file: &ExperimentFile, robot: usize) -> u64 {
    file.seed.wrapping_mul(SEEDS_OF_A_SCENARIO).wrapping_add(robot as u64)
}

/// Reads a task and its robot, or `robot`; the command interface is that of robot.toml unless given.
fn of_task(
    extensions: &Extensions,
    files: Files,
    (task, robot): (&Path, Option<&Path>),
    backend: Option<CommandKind>,
    options: RunOptions,
    settings: &[String],
) -> Result<Experiment, FileError> {
    // Mistakes in the files are reported when the files are combined.
    let declared = || Experiment::declared_command(extensions, files, task, robot, settings);
    let backend = backend.unwrap_or_else(|| declared().unwrap_or(CommandKind::Position));
    Experiment::load_with(extensions, files, task, robot, RunOptions { backend, ..options }, settings)
}

/// Reads the task of a robot.
fn member(
    extensions: &Extensions,
    files: Files,
    path: &Path,
    robot: &ExperimentRobot,
    set: &[String],
    (seed, allow): (u64, &[Code]),
    file: &ExperimentFile,
) -> Result<Experiment, FileError> {
    let task = beside(path, &robot.task);
    let folder = robot.robot.as_ref().map(|robot| beside(path, robot));
    let options = RunOptions {
        controller: robot.controller.unwrap_or(ControllerKind::Osc),
        transformer: robot.transformer.clone(),
        profile: robot.profile.clone(),
        seed: Some(seed),
        duration_s: Some(file.duration_s.get()),
        allow: allow.to_vec(),
        ..RunOptions::default()
    };
    of_task(extensions, files, (&task, folder.as_deref()), robot.backend, options, set)
}

/// Setting that places a robot of an experiment in the world that the robots share.
const MOUNT: &str = "robot.mount";

/// Placement of a robot's base that the file of an experiment states, with its key there.
fn stated_base(
    source: &Source,
    name: &str,
    robot: &ExperimentRobot,
) -> Result<Option<(&'static str, MountFile)>, FileError> {
    let document = checked(source)?;
    let is_stated = |key: &&str| {
        let path = ["robots", name, key].map(str::to_owned);
        depth_of(document.get_ref(), &path) == path.len()
    };
    let Some(key) = ["base_m", "base_rpy_rad"].into_iter().find(is_stated) else { return Ok(None) };
    let mount = MountFile::new(robot.base_m, robot.base_rpy_rad);
    if let Some((part, message, help)) = mount.mistake() {
        let key = if part == "xyz_m" { "base_m" } else { "base_rpy_rad" };
        return Err(FileError::at_key(source, ["robots", name, key], message, Some(help.to_owned())));
    }
    Ok(Some((key, mount)))
}

/// Refuses a robot that its own file, or one of its settings, places in the world too.
fn refuse_second_mount(
    source: &Source,
    (name, key): (&str, &str),
    experiment: &Experiment,
    set: &[String],
) -> Result<(), FileError> {
    let robot = &experiment.robot().source;
    let document = checked(&Source::new(robot.name(), std::sync::Arc::clone(&robot.base)))
        .map(|document| depth_of(document.get_ref(), &["mount".to_owned()]) == 1);
    let is_mount = |set: &&String| {
        set.trim_start().strip_prefix(MOUNT).is_some_and(|rest| rest.trim_start().starts_with(['.', '=']))
    };
    let other = match set.iter().find(is_mount) {
        Some(setting) => format!("`{setting}`"),
        None if document.unwrap_or(false) => format!("[mount] of {}", robot.name()),
        None => return Ok(()),
    };
    let message = format!("both `{key}` and {other} place the base of robot '{name}' in the world");
    let help = Some(format!("remove one of them: `{key}` here is for a robot whose file has no [mount]"));
    Err(FileError::at_key(source, ["robots", name, key], message, help))
}

/// Places an error about a setting that a coupling or a robot (its number and name) wrote at the entry in the experiment's file.
fn placed(
    error: FileError,
    source: &Source,
    couplings: &[Coupling],
    (number, robot): (usize, &str),
    of_robot: &[String],
) -> FileError {
    let text = match error.excerpt() {
        Some((text, _)) if error.line().is_none() => text,
        _ => return error,
    };
    let is_written =
        |coupling: &&Coupling| task_settings(source, coupling, number).iter().any(|set| set == text);
    let key = match couplings.iter().find(is_written) {
        Some(coupling) => vec!["couplings".to_owned(), coupling.name.clone()],
        None => match of_robot.iter().rposition(|set| set == text) {
            Some(place) => vec!["robots".to_owned(), robot.to_owned(), "set".to_owned(), place.to_string()],
            None => return error,
        },
    };
    let message = format!("robot '{robot}': {}", error.message());
    FileError::at_key(source, key, message, error.help().map(str::to_owned))
}
