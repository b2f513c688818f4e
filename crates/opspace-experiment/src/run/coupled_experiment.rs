//! Experiment with several robots: each with its own task, backend, rate and log, coupled through channels.
//!
//! All robots run on one clock. A robot sees the others only through links; what it received is in its own log, so that each
//! log can be replayed alone.

use crate::codes::{AllowedRefusal, Code};
use crate::extensions::Extensions;
use crate::files::controller_kind::ControllerKind;
use crate::files::experiment_file::{
    ChannelFile, CouplingEnd, CouplingFile, ExperimentFile, ExperimentRobot,
};
use crate::files::origin::{Files, Kind, beside};
use crate::files::overrides;
use crate::files::source::{FileError, Source, parse};
use crate::run::coupling_expectations::check_expectations;
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::experiment::{Experiment, RunOptions};
use crate::run::membership::Membership;
use crate::suggest::choices;
use crate::text::format_short;
use crate::transformers::check_name;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::{
    Backend, Capabilities, GroundTruth, Layout, Signal, Sink, TICK, TruthLayouts, signal_names,
};
use opspace_control::{CouplingKind, CouplingSide, Reflected, TeleoperationParameters};
use opspace_loop::{ChannelParameters, ControlLoop, Driven, Link, Run, RunOutcome, Timeline, drive_together};
use opspace_model::Placement;
use opspace_sim::{
    ArmConfig, HeldObjectConfig, Key, PhysicsEngine, SimulatedArm, SimulationConfig, SimulationError,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Distance of a rate from a whole number of hertz that is rounding, relative.
const ROUNDING: f64 = 1e-9;

/// Robot of a coupled experiment.
#[derive(Clone, Debug)]
pub struct Member {
    /// Name of the robot in the file.
    pub name: String,
    /// Its task.
    pub experiment: Experiment,
    pub(super) rate_hz: u32,
}

/// Coupling of a coupled experiment.
#[derive(Clone, Debug)]
pub struct Coupling {
    /// Name of the coupling.
    pub name: String,
    /// Number and task of the leader.
    pub leader: (usize, String),
    /// Number and task of the follower.
    pub follower: (usize, String),
    /// The entry in the file.
    pub file: CouplingFile,
    channel: ChannelFile,
}

/// Experiment with several robots, read from its file and checked.
#[derive(Clone, Debug)]
pub struct CoupledExperiment {
    /// Text of the file, with settings applied.
    pub source: Source,
    /// Contents of the file.
    pub file: ExperimentFile,
    /// Robots, in the order of their names.
    pub members: Vec<Member>,
    /// Couplings, in the order of their names.
    pub couplings: Vec<Coupling>,
    /// Settings with which it was loaded, without that of the seed.
    pub settings: Vec<String>,
    /// Name of the settings in the table of a suite.
    pub label: Option<String>,
}

impl Member {
    /// Returns a robot of the experiment in `source`.
    ///
    /// # Errors
    /// A robot whose rate is not a whole number of hertz.
    pub(super) fn new(name: &str, experiment: Experiment, source: &Source) -> Result<Self, FileError> {
        let rate_hz = rate_hz(&experiment)
            .ok_or_else(|| FileError::at_key(source, ["robots", name], NOT_WHOLE, None))?;
        Ok(Self { name: name.to_owned(), experiment, rate_hz })
    }
}

impl Coupling {
    /// Law of the coupling.
    #[must_use]
    pub fn kind(&self) -> CouplingKind {
        if self.file.carry.is_some() { CouplingKind::Carry } else { CouplingKind::Teleoperation }
    }

    /// Parameters of the teleoperation, if it is one.
    #[must_use]
    pub fn teleoperation(&self) -> Option<&TeleoperationParameters> {
        self.file.teleoperation.as_ref()
    }

    /// Name of the law in files.
    fn law_name(&self) -> &'static str {
        match self.kind() {
            CouplingKind::Carry => "carry",
            _ => "teleoperation",
        }
    }
}

impl CoupledExperiment {
    /// Reads an experiment and all files that it names. Settings that begin with the name of a robot and a dot are settings
    /// of this robot (`leader.task.hand.coupled.damping_ns_per_m=5`), all others change the file of the experiment.
    ///
    /// # Errors
    /// Mistakes in any of the files, and contradictions between them, each with its place.
    pub fn load(
        extensions: &Extensions,
        files: Files,
        path: &Path,
        settings: &[String],
    ) -> Result<Self, FileError> {
        Self::load_allowing(extensions, files, path, settings, &[])
    }

    /// Reads an experiment like [`load`](Self::load), and allows refusals with these codes.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_allowing(
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
            if let Some(transformer) = &robot.transformer {
                let key = ["robots", name, "transformer"];
                check_name(extensions, transformer, &source, key)?;
            }
            let mut set = robot.set.clone();
            set.push(format!("settle_s={}", file.settle_s.get()));
            for coupling in &couplings {
                set.extend(task_settings(&source, coupling, number));
            }
            set.extend(of_robots.remove(name).unwrap_or_default());
            let options = (seed_of(&file, number), allow);
            let mut experiment = member(extensions, files, path, robot, &set, options, &file)
                .map_err(|error| placed(error, &source, &couplings, (number, name), &robot.set))?;
            experiment.membership =
                Some(Membership { robot: name.clone(), experiment: source.clone(), settings: kept.clone() });
            members.push(Member::new(name, experiment, &source)?);
        }
        let mut new = Self { source, file, members, couplings, settings: kept, label: None };
        new.check_couplings()?;
        for (coupling, refusal) in new.refusals() {
            new.refuse(coupling, refusal)?;
        }
        if !new.file.objects.is_empty() {
            new.simulated_arms()?;
        }
        let names: Vec<&str> = new.couplings.iter().map(|coupling| coupling.name.as_str()).collect();
        check_expectations(&new.source, &new.file.expect, &names)?;
        Ok(new)
    }

    /// Names of the robots in a file.
    ///
    /// # Errors
    /// A file that is not one of an experiment with several robots.
    pub fn robot_names(files: Files, path: &Path) -> Result<Vec<String>, FileError> {
        robot_names(&files.read(path)?)
    }

    /// Refusals that the user has allowed, each once.
    #[must_use]
    pub fn allowed(&self) -> Vec<&AllowedRefusal> {
        let mut all: Vec<&AllowedRefusal> = Vec::new();
        for refusal in self.members.iter().flat_map(|member| member.experiment.allowed()) {
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

    /// Name of the experiment: its file name without extension.
    #[must_use]
    pub fn name(&self) -> String {
        let stem = Path::new(self.source.name()).file_stem();
        stem.map_or_else(|| self.source.name().to_owned(), |s| s.to_string_lossy().into_owned())
    }

    /// Duration of control, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.file.duration_s.get()
    }

    /// Number of interface cycles of all robots in a complete run, with the rest before control starts.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.members.iter().map(|member| member.experiment.ticks()).sum()
    }

    /// Paths of the files from which the experiment was read.
    #[must_use]
    pub fn input_paths(&self) -> Vec<PathBuf> {
        let of_members = self.members.iter().flat_map(|member| member.experiment.input_paths());
        of_members.chain([self.source.name().into()]).collect()
    }

    /// Returns the experiment with all robots on another plant; each has one of its own.
    ///
    /// # Errors
    /// A robot that the engine cannot simulate.
    pub fn on_engine(mut self, engine: &Arc<dyn PhysicsEngine>) -> Result<Self, FileError> {
        for member in &mut self.members {
            member.experiment = member.experiment.clone().on_engine(Arc::clone(engine))?;
        }
        Ok(self)
    }

    /// Runs the experiment in simulation. `open` gets the number of a robot, its capabilities and the layouts of its true state,
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

    /// Runs the experiment on these robots, in their order, as [`drive`](Self::drive) does.
    pub(crate) fn drive_robots<S: Sink>(
        &self,
        robots: &mut [&mut dyn Backend],
        progress: &Progress,
        mut open: impl FnMut(usize, &Capabilities, Option<TruthLayouts>) -> Result<(ControlLoop, S), RunError>,
    ) -> Result<Vec<(S, RunOutcome)>, RunError> {
        let mut loops = Vec::new();
        let mut sinks = Vec::new();
        for (number, robot) in robots.iter().enumerate() {
            let truth = robot.ground_truth().map(GroundTruth::layouts);
            let (control, sink) = open(number, robot.capabilities(), truth)?;
            loops.push(control);
            sinks.push(sink);
        }
        let rates: Vec<u32> = self.members.iter().map(|member| member.rate_hz).collect();
        let mut timeline =
            Timeline::new(&rates).map_err(|error| self.mistake("robots", &error.to_string()))?;
        let mut links = self.links(&timeline, &loops)?;
        let mut runs: Vec<Run<'_>> = loops
            .into_iter()
            .zip(&mut sinks)
            .map(|(control, sink)| {
                Run::new(control, self.duration_s(), sink).with_stop_request(&progress.interrupt)
            })
            .collect();
        let mut driven: Vec<Driven<'_, '_>> = robots
            .iter_mut()
            .zip(&mut runs)
            .map(|(robot, run)| Driven { backend: &mut **robot, run })
            .collect();
        drive_together(&mut driven, &mut links, &mut timeline);
        drop(driven);
        let outcomes: Vec<RunOutcome> = runs.into_iter().map(Run::finish).collect();
        Ok(sinks.into_iter().zip(outcomes).collect())
    }

    /// Arms of the simulation: each in a plant of its own, or all in one if hands hold an object.
    pub(crate) fn simulated_arms(&self) -> Result<Vec<SimulatedArm>, FileError> {
        if self.file.objects.is_empty() {
            return self.members.iter().map(|member| member.experiment.simulated_arm()).collect();
        }
        let names: Vec<String> = self.members.iter().map(|member| member.name.clone()).collect();
        let arms = self.members.iter().map(|member| {
            let robot = &self.file.robots[&member.name];
            let placement = Placement::from_rpy(robot.base_rpy_rad, robot.base_m);
            Ok(ArmConfig { placement, ..member.experiment.arm_config()? })
        });
        let objects = self.file.objects.iter().map(|(name, object)| HeldObjectConfig {
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

    /// Links in both directions between all robots: with the packets of a coupling between two that have one.
    fn links(&self, timeline: &Timeline, loops: &[ControlLoop]) -> Result<Vec<Link>, RunError> {
        let rows: Vec<Layout> =
            loops.iter().map(|control| Run::layouts(control, None).swap_remove(TICK)).collect();
        let mut links = Vec::new();
        let mistake = |key: &str, error: opspace_loop::LinkError| self.mistake(key, &error.to_string());
        let mut seed = self.file.seed.wrapping_mul(SEEDS_OF_AN_EXPERIMENT).wrapping_add(FIRST_CHANNEL);
        for coupling in &self.couplings {
            let key = format!("couplings.{}", coupling.name);
            for (from, to) in [(&coupling.leader, &coupling.follower), (&coupling.follower, &coupling.leader)]
            {
                let parameters = channel_parameters(&coupling.channel, seed);
                seed = seed.wrapping_add(1);
                let signals = coupling.kind().packet_signals().into_iter();
                let signals: Vec<(String, &str)> =
                    signals.map(|(signal, input)| (signal_names::of(&from.1, signal), input)).collect();
                let copies: Vec<(&str, &str)> =
                    signals.iter().map(|(signal, input)| (signal.as_str(), *input)).collect();
                let target = (to.0, &loops[to.0].targets(), to.1.as_str());
                let link = Link::new(timeline, (from.0, &rows[from.0]), target, &copies, parameters);
                links.push(link.map_err(|error| mistake(&key, error))?);
            }
        }
        for (from, row) in rows.iter().enumerate() {
            for to in 0..loops.len() {
                let linked = links.iter().any(|link: &Link| link.from() == from && link.to() == to);
                if from != to && !linked {
                    let parameters = channel_parameters(&ChannelFile::default(), seed);
                    let link = Link::status(timeline, (from, row), to, parameters);
                    links.push(link.map_err(|error| mistake("robots", error))?);
                }
            }
        }
        Ok(links)
    }

    fn mistake(&self, key: &str, message: &str) -> FileError {
        FileError::at_key(&self.source, key, message, None)
    }

    /// Checks each coupling against the tasks that it names.
    fn check_couplings(&self) -> Result<(), FileError> {
        for coupling in &self.couplings {
            let key = format!("couplings.{}", coupling.name);
            let rows = [&coupling.leader, &coupling.follower].map(|(robot, task)| {
                let experiment = &self.members[*robot].experiment;
                let control = experiment.control_loop().ok()?;
                let name = signal_names::of(task, signal_names::PORT_POSITION);
                let signals = Run::layouts(&control, None).swap_remove(TICK).signals;
                signals.into_iter().find(|signal| signal.name == name)
            });
            let [Some(leader), Some(follower)] = rows else { continue };
            if leader.units != follower.units {
                let message = format!(
                    "the two tasks have different rows: {} of the leader, {} of the follower",
                    described(&leader),
                    described(&follower)
                );
                let help = Some("couple the same number of axes or joints, in the same units".to_owned());
                return Err(FileError::at_key(&self.source, key, message, help));
            }
        }
        Ok(())
    }

    /// Refusals of the couplings, each with the index of its coupling.
    fn refusals(&self) -> Vec<(usize, FileError)> {
        let each = self.couplings.iter().enumerate();
        each.flat_map(|(i, coupling)| {
            let found = [self.late_packets(coupling), self.active_waves(coupling)];
            found.into_iter().flatten().map(move |refusal| (i, refusal))
        })
        .collect()
    }

    /// Refuses the experiment, or records the refusal with both robots of the coupling if the user allows its code.
    fn refuse(&mut self, coupling: usize, refusal: FileError) -> Result<(), FileError> {
        let Coupling { leader, follower, .. } = &self.couplings[coupling];
        let (leader, follower) = (leader.0, follower.0);
        self.members[leader].experiment.refuse(refusal.clone())?;
        self.members[follower].experiment.refuse(refusal)
    }

    /// Refusal of a channel whose packets arrive later than the receiver waits for them.
    fn late_packets(&self, coupling: &Coupling) -> Option<FileError> {
        let name = coupling.file.channel.as_ref()?;
        let ChannelFile { delay_s, jitter_s, hold_after_s, .. } = coupling.channel;
        let refuse = |key: &str, message: String, help: String| {
            let found = FileError::at_key(&self.source, ["channels", name, key], message, Some(help));
            Some(found.refused(Code::LatePackets))
        };
        let (latest_s, hold_s) = (delay_s.get() + jitter_s.get(), hold_after_s.get());
        if latest_s >= hold_s {
            let message = format!(
                "delay_s + jitter_s is {} s, but a robot that hears nothing for {} s (hold_after_s) is held",
                format_short(latest_s),
                format_short(hold_s)
            );
            let help =
                format!("choose less than {} s in sum, or a larger hold_after_s", format_short(hold_s));
            return refuse("delay_s", message, help);
        }
        // The age of a packet counts from its arrival, so that a constant delay does not matter.
        let law = &coupling.file;
        let timeout_s = law.teleoperation.as_ref().map(|law| law.timeout_s);
        let timeout_s = timeout_s.or(law.carry.as_ref().map(|law| law.timeout_s)).map(Positive::get);
        if let Some(timeout_s) = timeout_s.filter(|timeout_s| jitter_s.get() >= *timeout_s) {
            let message = format!(
                "coupling '{}' opens {} s (timeout_s) after the last packet, but packets may arrive {} s apart",
                coupling.name,
                format_short(timeout_s),
                format_short(jitter_s.get())
            );
            let help = format!("choose less than {} s, or a larger timeout_s", format_short(timeout_s));
            return refuse("jitter_s", message, help);
        }
        None
    }

    /// Refusal of wave variables where they are not passive.
    fn active_waves(&self, coupling: &Coupling) -> Option<FileError> {
        let reflects = coupling.teleoperation().map(|law| law.reflect);
        if !matches!(reflects, Some(Reflected::Waves { .. })) {
            return None;
        }
        let refuse = |message: String, help: &str| {
            let key = ["couplings", &coupling.name, "teleoperation", "reflect"];
            let found = FileError::at_key(&self.source, key, message, Some(help.to_owned()));
            Some(found.refused(Code::ActiveWaves))
        };
        if coupling.channel.jitter_s != NonNegative::default() || coupling.channel.loss.get() != 0.0 {
            let message =
                "wave variables are passive with a constant delay only, but the channel has jitter or loss";
            return refuse(
                message.to_owned(),
                "choose another `reflect`, or a channel without jitter_s and loss",
            );
        }
        let rates = [coupling.leader.0, coupling.follower.0].map(|robot| self.members[robot].rate_hz);
        let (slower, faster) = (rates[0].min(rates[1]), rates[0].max(rates[1]));
        if faster % slower != 0 {
            let message = format!(
                "wave variables need equal rates, or one that is a multiple of the other; the leader has {} Hz, the follower {} Hz",
                rates[0], rates[1]
            );
            return refuse(message, "choose another `reflect`, or other profiles of the robots");
        }
        None
    }
}

fn robot_names(source: &Source) -> Result<Vec<String>, FileError> {
    Kind::Experiment.require(source)?;
    Ok(parse::<ExperimentFile>(source)?.robots.into_keys().collect())
}

/// Message for a robot that no clock can order.
const NOT_WHOLE: &str = "the rate of this robot is not a whole number of hertz";

/// Distance of the seeds of experiments with adjacent seeds, and the first seed of a channel within it.
const SEEDS_OF_AN_EXPERIMENT: u64 = 1000;
const FIRST_CHANNEL: u64 = 500;

fn seed_of(file: &ExperimentFile, robot: usize) -> u64 {
    file.seed.wrapping_mul(SEEDS_OF_AN_EXPERIMENT).wrapping_add(robot as u64)
}

fn described(signal: &Signal) -> String {
    let rows = signal.elements.iter().zip(&signal.units).map(|(row, unit)| format!("{row} ({unit})"));
    rows.collect::<Vec<_>>().join(", ")
}

fn channel_parameters(channel: &ChannelFile, seed: u64) -> ChannelParameters {
    ChannelParameters {
        delay_s: channel.delay_s.get(),
        jitter_s: channel.jitter_s.get(),
        loss: channel.loss.get(),
        reordering: channel.reordering,
        seed,
        hold_after_s: Some(channel.hold_after_s.get()),
    }
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
    let backend = match robot.backend {
        Some(backend) => backend,
        None => Experiment::declared_command(extensions, files, &task, folder.as_deref(), set)?,
    };
    let options = RunOptions {
        backend,
        controller: robot.controller.unwrap_or(ControllerKind::Osc),
        transformer: robot.transformer.clone(),
        profile: robot.profile.clone(),
        seed: Some(seed),
        duration_s: Some(file.duration_s.get()),
        label: None,
        allow: allow.to_vec(),
    };
    Experiment::load_with(extensions, files, &task, folder.as_deref(), options, set)
}

/// Rate of a robot's interface, if it is a whole number of hertz.
fn rate_hz(experiment: &Experiment) -> Option<u32> {
    let rate = Positive::try_from(1.0 / experiment.profile().1.period_s()).ok()?.get();
    let whole = rate.round();
    ((rate - whole).abs() <= ROUNDING * rate && whole >= 1.0 && whole <= f64::from(u32::MAX))
        .then_some(whole as u32)
}

/// Resolves the couplings of a file.
pub(super) fn couplings(file: &ExperimentFile, source: &Source) -> Result<Vec<Coupling>, FileError> {
    let names: Vec<&str> = file.robots.keys().map(String::as_str).collect();
    let mut found: Vec<Coupling> = Vec::new();
    for (name, entry) in &file.couplings {
        let end = |end: &CouplingEnd, side: &str| {
            let number = names.iter().position(|known| *known == end.robot).ok_or_else(|| {
                let message = format!("there is no robot '{}'", end.robot);
                let key = ["couplings", name, side, "robot"];
                FileError::at_key(source, key, message, Some(choices(&end.robot, &names)))
            })?;
            Ok::<_, FileError>((number, end.task.clone()))
        };
        if entry.teleoperation.is_some() == entry.carry.is_some() {
            let help = Some("add `teleoperation = {}`, or `carry = { direction = [...] }`".to_owned());
            let message = "a coupling needs one law: `teleoperation` or `carry`";
            return Err(FileError::at_key(source, ["couplings", name], message, help));
        }
        let (leader, follower) = (end(&entry.leader, "leader")?, end(&entry.follower, "follower")?);
        if leader.0 == follower.0 {
            let key = ["couplings", name, "follower", "robot"];
            return Err(FileError::at_key(source, key, "a robot cannot be coupled with itself", None));
        }
        let is_taken = |end: &(usize, String)| found.iter().any(|c| c.leader == *end || c.follower == *end);
        if let Some((side, end)) =
            [("leader", &leader), ("follower", &follower)].into_iter().find(|(_, e)| is_taken(e))
        {
            let message = format!("task '{}' is already coupled", end.1);
            return Err(FileError::at_key(source, ["couplings", name, side, "task"], message, None));
        }
        let channel = match &entry.channel {
            None => ChannelFile::default(),
            Some(wanted) => *file.channels.get(wanted).ok_or_else(|| {
                let known: Vec<&str> = file.channels.keys().map(String::as_str).collect();
                let message = format!("there is no channel '{wanted}'");
                FileError::at_key(
                    source,
                    ["couplings", name, "channel"],
                    message,
                    Some(choices(wanted, &known)),
                )
            })?,
        };
        found.push(Coupling { name: name.clone(), leader, follower, file: entry.clone(), channel });
    }
    for (number, name) in names.iter().enumerate() {
        if !found.iter().any(|coupling| coupling.leader.0 == number || coupling.follower.0 == number) {
            let help = Some("add a coupling, or remove the robot".to_owned());
            let message = "this robot is not coupled with another one";
            return Err(FileError::at_key(source, ["robots", name], message, help));
        }
    }
    Ok(found)
}

/// Settings that write a coupling into the task of a robot, if it takes part in it.
fn task_settings(source: &Source, coupling: &Coupling, robot: usize) -> Vec<String> {
    let sides = [(&coupling.leader, CouplingSide::Leader), (&coupling.follower, CouplingSide::Follower)];
    let Some(((_, task), side)) = sides.into_iter().find(|((number, _), _)| *number == robot) else {
        return Vec::new();
    };
    let side = match side {
        CouplingSide::Leader => "leader",
        CouplingSide::Follower => "follower",
    };
    let document: toml::Table = source.text().parse().unwrap_or_default();
    let law = document
        .get("couplings")
        .and_then(|couplings| couplings.get(&coupling.name)?.get(coupling.law_name()))
        .map_or_else(|| "{}".to_owned(), toml::Value::to_string);
    let name = coupling.law_name();
    vec![format!("task.{task}.coupled.side=\"{side}\""), format!("task.{task}.coupled.{name}={law}")]
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
