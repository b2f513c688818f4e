//! Experiment: a task on a robot, assembled from the task file and the robot file.

use crate::codes::{AllowedRefusal, Code};
use crate::extensions::Extensions;
use crate::files::controller_kind::ControllerKind;
use crate::files::origin::Files;
use crate::files::overrides::split;
use crate::files::robot::RobotDefinition;
use crate::files::source::{FileError, Source};
use crate::files::task::LONGEST_RUN_S;
use crate::files::task::TaskDefinition;
use crate::run::collision::{KeptDistances, kept_distances};
use crate::run::comparisons::refuse_comparisons;
use crate::run::expectations;
use crate::run::membership::Membership;
use crate::run::path_bounds::{PASSES, bounds, path_of, time_optimal_paths};
use crate::run::path_dynamics::JointBounds;
use crate::run::physics::Physics;
use crate::run::rollout::{Rollout, RolloutCase};
use crate::run::start_positions::{IN_DEGREES, are_degrees, check_start, others_outside};
use crate::suggest::choices;
use crate::transformers::check_robot;
use crate::transformers::setup::setpoint_limits;
use opspace_backend::quantity::Positive;
use opspace_backend::{Capabilities, CommandKind, GravityCompensation, MissedCycle, StopMethod};
use opspace_control::hierarchy::task_parameters::largest_unused_damping_per_s;
use opspace_control::{
    ControlContext, ControlError, Controller, InverseKinematicsController, LimitParameters,
    OperationalSpaceController, PathReference, Reason, ServoLead, TaskParameters, TaskSet, TaskSetParameters,
    ViableSpeeds,
};
use opspace_loop::{
    CollisionDetector, ControlLoop, EstimatedForce, LoopConfig, LoopError, SensorCompensation,
};
use opspace_model::{Data, Model};
use opspace_sim::{
    ArmConfig, Key, PhysicsEngine, PlantError, Scene, SimulatedArm, Simulation, SimulationConfig,
    SimulationError,
};
use opspace_transformer::{
    FrictionCompensation, FrictionObserver, JointParameters, ProfileParameters, ServoGains, TransformerName,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Fraction of the acceleration limit of the drives' setpoints that inverse kinematics uses: velocity lead and the jerk limit
/// need the rest.
const USED_SETPOINT_ACCELERATION: f64 = 0.8;

/// Options of an experiment besides the two files.
#[derive(Clone, Debug, PartialEq)]
pub struct RunOptions {
    /// Command interface of the robot. For a position or velocity robot, the transformer converts the torques of a
    /// torque controller.
    pub backend: CommandKind,
    /// Controller.
    pub controller: ControllerKind,
    /// Transformer that replaces the one of the profile.
    pub transformer: Option<TransformerName>,
    /// Profile that replaces the default profile of the robot.
    pub profile: Option<String>,
    /// Seed that replaces the one of the task.
    pub seed: Option<u64>,
    /// Duration that replaces the one of the task, s.
    pub duration_s: Option<f64>,
    /// Name of the run's settings in the table of a suite.
    pub label: Option<String>,
    /// Refusals that the user allows.
    pub allow: Vec<Code>,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            backend: CommandKind::Position,
            controller: ControllerKind::Osc,
            transformer: None,
            profile: None,
            seed: None,
            duration_s: None,
            label: None,
            allow: Vec::new(),
        }
    }
}

/// Seconds of a day.
const SECONDS_PER_DAY: f64 = 86_400.0;

/// Size of a log per second of a run, bytes: that of a simulated arm of seven joints at 1 kHz.
const LOG_BYTES_PER_S: f64 = 0.5e6;

/// Validated task on a robot: all its parts can be built.
#[derive(Clone, Debug)]
pub struct Experiment {
    pub(super) robot: RobotDefinition,
    pub(super) task: TaskDefinition,
    pub(super) options: RunOptions,
    settings: Vec<String>,
    pub(super) profile_name: String,
    pub(super) profile: ProfileParameters,
    distances: Option<KeptDistances>,
    pub(super) physics: Physics,
    pub(super) membership: Option<Membership>,
    pub(super) allowed: Vec<AllowedRefusal>,
}

impl Experiment {
    /// Reads the task file and its robot file (or `robot`, if given) and combines them. Entries of `settings` that
    /// begin with `robot.` change the robot file, all others the task file.
    ///
    /// # Errors
    /// Mistakes in either file, or contradictions between them, each with its place.
    pub fn load(
        files: Files,
        task: &Path,
        robot: Option<&Path>,
        options: RunOptions,
        settings: &[String],
    ) -> Result<Self, FileError> {
        Self::load_with(&Extensions::default(), files, task, robot, options, settings)
    }

    /// Reads a task and its robot like [`load`](Self::load), with tasks and drivers defined by the user.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_with(
        extensions: &Extensions,
        files: Files,
        task: &Path,
        robot: Option<&Path>,
        options: RunOptions,
        settings: &[String],
    ) -> Result<Self, FileError> {
        let (robot_settings, task_settings) = split(settings, "robot");
        let task = TaskDefinition::load_with(extensions, files, task, &task_settings)?;
        if robot.is_none() {
            files.read_named(&files.robot_file(&task.robot_path()), &task.source, "robot")?;
        }
        let robot_path = robot.map_or_else(|| task.robot_path(), Path::to_owned);
        let robot = RobotDefinition::load(files, &robot_path, &robot_settings)?;
        Self::new(robot, task, options, settings.to_vec())
    }

    /// Returns the command interface declared in robot.toml of the task's robot, or of `robot` if given. `settings`
    /// as in [`load`](Self::load).
    ///
    /// # Errors
    /// Mistakes in either file, each with its place.
    pub fn declared_command(
        extensions: &Extensions,
        files: Files,
        task: &Path,
        robot: Option<&Path>,
        settings: &[String],
    ) -> Result<CommandKind, FileError> {
        let (robot_settings, task_settings) = split(settings, "robot");
        let robot = match robot {
            Some(robot) => robot.to_owned(),
            None => TaskDefinition::load_with(extensions, files, task, &task_settings)?.robot_path(),
        };
        Ok(RobotDefinition::load(files, &robot, &robot_settings)?.file.interface.command)
    }

    /// Combines a task and a robot. `settings` are only recorded, not applied.
    ///
    /// # Errors
    /// Contradictions between the two, each with its place.
    pub fn new(
        robot: RobotDefinition,
        task: TaskDefinition,
        options: RunOptions,
        settings: Vec<String>,
    ) -> Result<Self, FileError> {
        check_robot(&task.tables, &robot)?;
        if !task.tables.has_comparisons {
            refuse_comparisons(&task)?;
        }
        let (name, profile) = robot.profile(options.profile.as_deref())?;
        let (profile_name, profile) = (name.to_owned(), profile.clone());
        let distances = kept_distances(&robot, &task)?;
        let physics = Physics::Own;
        let mut experiment = Self {
            robot,
            task,
            options,
            settings,
            profile_name,
            profile,
            distances,
            physics,
            membership: None,
            allowed: Vec::new(),
        };
        experiment.check_choice()?;
        experiment.check_duration()?;
        experiment.check_masses()?;
        experiment.check_friction_observer()?;
        expectations::check(&experiment.task, &experiment.robot)?;
        experiment.start()?;
        experiment.bound_paths()?;
        experiment.controller()?;
        if experiment.robot.file.simulated.is_some() && experiment.robot.massless.is_empty() {
            experiment.simulated_arm()?;
        }
        Ok(experiment)
    }

    /// Checks that a robot file has all that a simulation of the robot needs, with each of its profiles. A robot without
    /// `[simulated]` passes.
    ///
    /// # Errors
    /// Values that contradict each other, at their place in the robot file.
    pub fn check_simulated(robot: &RobotDefinition) -> Result<(), FileError> {
        if robot.file.simulated.is_none() || !robot.massless.is_empty() {
            return Ok(());
        }
        let middles = robot.model.joints().iter().filter_map(|joint| {
            let middle = 0.5 * (joint.limits.lower + joint.limits.upper);
            middle.is_finite().then(|| format!("{} = {middle:?}", toml_edit::Key::new(&joint.name)))
        });
        let start = middles.collect::<Vec<_>>().join(", ");
        let text = format!("robot = '.'\nduration_s = 1.0\npriority = []\nstart_rad = {{ {start} }}\n");
        let at_rest = Source::new("a task at rest", text);
        let task = TaskDefinition::from_sources(at_rest, |recording| {
            Err(FileError::of_file(recording.file.display().to_string(), "a task at rest has no paths", None))
        })?;
        for (name, profile) in &robot.file.profile {
            let experiment = Self {
                robot: robot.clone(),
                task: task.clone(),
                options: RunOptions { backend: robot.file.interface.command, ..RunOptions::default() },
                settings: Vec::new(),
                profile_name: name.clone(),
                profile: profile.clone(),
                distances: None,
                physics: Physics::Own,
                membership: None,
                allowed: Vec::new(),
            };
            experiment.simulated_arm()?;
        }
        Ok(())
    }

    /// Combines another robot and another task with the tables of this experiment.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_parts(
        &self,
        robot: RobotDefinition,
        task: TaskDefinition,
        options: RunOptions,
    ) -> Result<Self, FileError> {
        let tables = self.task.tables.clone();
        Self::new(robot, TaskDefinition { tables, ..task }, options, Vec::new())
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &RobotDefinition {
        &self.robot
    }

    /// The task.
    #[must_use]
    pub fn task(&self) -> &TaskDefinition {
        &self.task
    }

    /// Distances that the controller keeps between links and from obstacles, if it enforces limits; `None` if the robot
    /// file has no `[collision]`.
    #[must_use]
    pub fn kept_distances(&self) -> Option<&KeptDistances> {
        self.distances.as_ref()
    }

    /// Experiment with several robots to which this one belongs, if it does.
    #[must_use]
    pub fn membership(&self) -> Option<&Membership> {
        self.membership.as_ref()
    }

    /// Paths of the files from which the experiment was read: robot, URDF, task, recorded paths and scene.
    #[must_use]
    pub fn input_paths(&self) -> Vec<PathBuf> {
        let sources = [&self.robot.source, &self.robot.urdf, &self.task.source];
        let sources = sources.into_iter().chain(self.task.recordings.values());
        let scene = self.scene().map(|scene| scene.path.clone());
        sources.map(|source| source.name().into()).chain(scene).collect()
    }

    /// Options that were chosen besides the files.
    #[must_use]
    pub fn options(&self) -> &RunOptions {
        &self.options
    }

    /// Refusals that the user has allowed.
    #[must_use]
    pub fn allowed(&self) -> &[AllowedRefusal] {
        &self.allowed
    }

    /// Refuses the experiment, or records the refusal if the user allows its code.
    pub fn refuse(&mut self, refusal: FileError) -> Result<(), FileError> {
        let Some(code) = refusal.code().filter(|code| self.options.allow.contains(code)) else {
            return Err(refusal);
        };
        let allowed = AllowedRefusal { code: code.name().to_owned(), message: refusal.message().to_owned() };
        if !self.allowed.contains(&allowed) {
            self.allowed.push(allowed);
        }
        Ok(())
    }

    /// Settings that were applied to the files.
    #[must_use]
    pub fn settings(&self) -> &[String] {
        &self.settings
    }

    /// Name and parameters of the profile in use.
    #[must_use]
    pub fn profile(&self) -> (&str, &ProfileParameters) {
        (&self.profile_name, &self.profile)
    }

    /// Seed in use.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.options.seed.unwrap_or(self.task.file.seed)
    }

    /// Duration of control, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.options.duration_s.unwrap_or(self.task.file.duration_s.get())
    }

    /// Refuses a duration whose log no disk holds.
    fn check_duration(&self) -> Result<(), FileError> {
        let duration_s = self.duration_s();
        if duration_s <= LONGEST_RUN_S {
            return Ok(());
        }
        let message = format!(
            "a run of {duration_s:e} s is longer than {LONGEST_RUN_S:e} s ({:.0} days): its log would have about {:.0e} GB",
            LONGEST_RUN_S / SECONDS_PER_DAY,
            self.log_bytes() / 1e9
        );
        let help = "give the duration in seconds, or make several runs".to_owned();
        Err(FileError::at_key(&self.task.source, "duration_s", message, Some(help)))
    }

    /// Estimate of the size of the log of a run over its whole duration, bytes.
    #[must_use]
    pub fn log_bytes(&self) -> f64 {
        LOG_BYTES_PER_S * self.duration_s()
    }

    /// Builds the controller; it has not been started.
    ///
    /// # Errors
    /// Parts of the task that are incompatible with the robot.
    pub fn controller(&self) -> Result<Box<dyn Controller>, FileError> {
        let facts = self.control_context(self.profile.period_s());
        let (model, file, events) = (&self.robot.model, &self.task.file, &self.task.events);
        let stack = self.stack(&file.priority, &file.task);
        let wrong = |e: ControlError| self.control_error(&e);
        match self.options.controller {
            ControllerKind::Osc => {
                let mut osc = OperationalSpaceController::new(model, &stack, &facts).map_err(wrong)?;
                for (number, event) in events.iter().enumerate() {
                    let stack = osc.prepare(model, &self.stack(&event.priority, &event.task));
                    let stack = stack.map_err(|e| self.event_error(number, &e))?;
                    match &event.contact {
                        Some(contact) => osc.schedule_at_contact(event.time_s, contact.clone(), stack),
                        None => osc.schedule(event.time_s, stack),
                    }
                }
                Ok(Box::new(osc))
            }
            ControllerKind::Ik | ControllerKind::IkLead => {
                let leads = self.options.controller == ControllerKind::IkLead;
                let lead = leads.then(|| self.servo_lead()).transpose()?;
                let facts = self.within_setpoint_limits(facts);
                let mut ik = InverseKinematicsController::new(model, &stack, &facts, lead).map_err(wrong)?;
                for (number, event) in events.iter().enumerate() {
                    let stack = ik.prepare(model, &self.stack(&event.priority, &event.task));
                    let stack = stack.map_err(|e| self.event_error(number, &e))?;
                    match &event.contact {
                        Some(contact) => ik.schedule_at_contact(event.time_s, contact.clone(), stack),
                        None => ik.schedule(event.time_s, stack),
                    }
                }
                Ok(Box::new(ik))
            }
        }
    }

    /// Builds the torque controller of the task without the robot's limits and with an update period of `period_s`.
    /// It serves to evaluate the motion that the references require, and commands torques for the state that it is given, however late
    /// they act. `None` if the task is incompatible with the
    /// robot.
    pub fn unlimited_controller(&self, period_s: f64) -> Option<OperationalSpaceController> {
        let model = &self.robot.model;
        let facts = ControlContext { command_delay_s: 0.0, ..self.control_context(period_s) };
        let file = &self.task.file;
        let limits = LimitParameters { enforce: false, horizon_s: None, ..file.limits };
        // The period may be longer than the robot's.
        let damping = file.unused_damping_per_s.get().min(largest_unused_damping_per_s(period_s));
        let unused_damping_per_s = Positive::try_from(damping).ok()?;
        let stack =
            TaskSetParameters { unused_damping_per_s, limits, ..self.stack(&file.priority, &file.task) };
        let mut osc = OperationalSpaceController::new(model, &stack, &facts).ok()?;
        for event in &self.task.events {
            let stack = self.stack(&event.priority, &event.task);
            let stack = TaskSetParameters { unused_damping_per_s, ..stack };
            osc.schedule(event.time_s, osc.prepare(model, &stack).ok()?);
        }
        Some(osc)
    }

    /// Run of this experiment from the joint positions `start` (n), whose references are rolled out.
    pub fn rollout_case<'a>(&'a self, start: &'a [f64]) -> RolloutCase<'a> {
        let duration_s = self.duration_s();
        let later = self.task.events.iter().map(|event| event.time_s).filter(|from_s| *from_s < duration_s);
        RolloutCase {
            model: &self.robot.model,
            start,
            sensors: self.robot.sensors.len(),
            duration_s,
            period_s: self.profile.period_s(),
            from_s: std::iter::once(0.0).chain(later).collect(),
            ranges: None,
            controller: Box::new(|period_s| self.unlimited_controller(period_s)),
        }
    }

    /// Fraction of the joints' velocity limits that the controller uses.
    pub fn velocity_fraction(&self) -> f64 {
        let limits = self.task.file.limits;
        if limits.enforce { limits.velocity_fraction.get().min(1.0) } else { 1.0 }
    }

    /// Limits of speed, torque and acceleration of the joints that are in force.
    fn joint_bounds<'a>(&self, model: &'a Model) -> JointBounds<'a> {
        let enforced = self.task.file.limits;
        let mut limits = self.robot.joint_limits();
        let period_s = self.profile.period_s();
        let viable = enforced.enforce.then(|| ViableSpeeds::new(model, &limits, &enforced, period_s));
        let velocity_fraction = self.velocity_fraction();
        // Without enforcement, torques are clipped to the whole limit, and accelerations are free.
        let torque_fraction = if enforced.enforce { enforced.torque_fraction.get().min(1.0) } else { 1.0 };
        limits.velocity.iter_mut().for_each(|limit| *limit *= velocity_fraction);
        limits.torque.iter_mut().for_each(|limit| *limit *= torque_fraction);
        if !enforced.enforce {
            limits.acceleration.fill(f64::INFINITY);
        }
        JointBounds {
            model,
            data: Data::new(model),
            limits,
            friction: self.robot.joints().into_iter().map(|joint| joint.friction).collect(),
            with_gravity: self.gravity_compensated_by() != GravityCompensation::Robot,
            viable,
        }
    }

    /// Bounds the motion along time-optimal paths such that the joints keep their limits of speed, torque and acceleration.
    fn bound_paths(&mut self) -> Result<(), FileError> {
        let mut paths = time_optimal_paths(self.task.task_sets_mut());
        if paths.is_empty() {
            return Ok(());
        }
        let start = self.start()?;
        let model = self.robot.model.clone();
        let mut joints = self.joint_bounds(&model);
        for _ in 0..PASSES {
            let rollout = Rollout::new(&self.rollout_case(&start));
            let found = paths.iter().map(|path| bounds(path, &rollout, &mut joints)).collect::<Vec<_>>();
            if found.iter().all(Option::is_none) {
                break;
            }
            for (path, bounds) in paths.iter_mut().zip(found) {
                let Some(bounds) = bounds else { continue };
                path.path = PathReference { bounds, ..(*path.path).clone() }.into();
                for (set, tasks) in self.task.task_sets_mut().enumerate() {
                    if path.sets.contains(&set)
                        && let Some(of_task) = tasks.get_mut(&path.task).and_then(path_of)
                    {
                        *of_task = path.path.clone();
                    }
                }
            }
        }
        Ok(())
    }

    fn control_context(&self, period_s: f64) -> ControlContext {
        ControlContext {
            period_s,
            command_delay_s: f64::from(self.profile.delay()) * self.profile.servo_period_s(),
            sensors: self.robot.sensors.clone(),
            estimated_sensors: self.robot.file.estimated_force.len(),
            gravity_by_robot: self.gravity_compensated_by() == GravityCompensation::Robot,
            limits: self.robot.joint_limits(),
            collision: self.distances.as_ref().map(|distances| distances.limits.clone()),
        }
    }

    /// Lowers the limits of speed and acceleration to those of the drives' setpoints, which are positions that the controller
    /// commands.
    fn within_setpoint_limits(&self, mut context: ControlContext) -> ControlContext {
        let limits = &mut context.limits;
        for (joint, of_drive) in setpoint_limits(&self.robot, &self.profile).iter().enumerate() {
            if let Some(velocity) = of_drive.velocity_rad_per_s {
                limits.velocity[joint] = limits.velocity[joint].min(velocity.get());
            }
            if let Some(acceleration) = of_drive.acceleration_rad_per_s2 {
                let used = USED_SETPOINT_ACCELERATION * acceleration.get();
                limits.acceleration[joint] = limits.acceleration[joint].min(used);
            }
        }
        context
    }

    /// Builds the tasks of a file or an event for the robot, after the set `before`; `None` if they are incompatible with it.
    pub fn task_set(
        &self,
        priority: &[String],
        task: &BTreeMap<String, TaskParameters>,
        before: Option<&TaskSet>,
    ) -> Option<TaskSet> {
        let context = self.control_context(self.profile.period_s());
        TaskSet::from_parameters(&self.robot.model, &self.stack(priority, task), &context, before).ok()
    }

    fn stack<'a>(
        &'a self,
        priority: &'a [String],
        task: &'a BTreeMap<String, TaskParameters>,
    ) -> TaskSetParameters<'a> {
        let file = &self.task.file;
        let (compensation, unused_damping_per_s, limits) =
            (file.compensation, file.unused_damping_per_s, file.limits);
        TaskSetParameters { priority, task, compensation, unused_damping_per_s, limits }
    }

    /// Builds the simulated robot with the selected command interface, at rest at the start position.
    ///
    /// # Errors
    /// A robot file without `[simulated]`, or parameters that contradict each other.
    pub fn simulated_arm(&self) -> Result<SimulatedArm, FileError> {
        self.simulated_arm_of(self.arm_config()?)
    }

    /// Returns an arm with a configuration that was changed after [`arm_config`](Self::arm_config), simulated by the plant of the
    /// experiment: with external forces, or with another start.
    ///
    /// # Errors
    /// Parameters that contradict each other, or that the plant cannot simulate.
    pub fn simulated_arm_of(&self, config: ArmConfig) -> Result<SimulatedArm, FileError> {
        let arm = match &self.physics {
            Physics::Own => SimulatedArm::new(config),
            Physics::Engine(engine) => SimulatedArm::on_engine(config, &**engine),
            Physics::Logged(_) | Physics::Replay(_) => return Err(self.missing_engine()),
        };
        arm.map_err(|e| self.simulation_error(&e))
    }

    /// Builds a simulation of several arms in the plant of this experiment.
    pub(crate) fn simulation_of(&self, config: SimulationConfig) -> Result<Simulation, SimulationError> {
        match &self.physics {
            Physics::Engine(engine) => Simulation::with_plant(config, |plant| engine.build(plant)),
            Physics::Own | Physics::Logged(_) | Physics::Replay(_) => Simulation::new(config),
        }
    }

    /// Returns the experiment simulated by another physics engine.
    ///
    /// # Errors
    /// A robot or a scene that the engine cannot simulate, or a robot that cannot be simulated at all.
    pub fn on_engine(mut self, engine: Arc<dyn PhysicsEngine>) -> Result<Self, FileError> {
        self.physics = Physics::of_engine(engine);
        self.simulated_arm()?;
        Ok(self)
    }

    /// True if the experiment runs on a log in place of a robot.
    pub(crate) fn is_on_log(&self) -> bool {
        matches!(self.physics, Physics::Replay(_))
    }

    /// Scene of the physics engine, if it has one.
    pub fn scene(&self) -> Option<&Scene> {
        self.physics.scene()
    }

    /// Path of the scene of the physics engine, as it was given; of a log, that of its engine.
    #[must_use]
    pub fn scene_path(&self) -> Option<String> {
        self.physics.scene_path()
    }

    /// Name of the plant of the simulation: `own`, or name and version of another engine and the file name of its scene; of
    /// a run on a log, `log` and its path.
    #[must_use]
    pub fn plant(&self) -> String {
        self.physics.label()
    }

    /// Returns the configuration of [`simulated_arm`](Self::simulated_arm), which can be modified or combined with
    /// that of another arm.
    ///
    /// # Errors
    /// A robot file without `[simulated]`.
    pub fn arm_config(&self) -> Result<ArmConfig, FileError> {
        let Some(simulated) = self.robot.file.simulated.clone() else {
            let help = "add [simulated]; `opspace schema robot` lists its keys".to_owned();
            let message = "this robot has no [simulated] section, so it cannot be simulated";
            let found = FileError::of_file(self.robot.source.name(), message, Some(help));
            return Err(found.refused(Code::NotSimulated));
        };
        let servos = self.servos()?;
        // Brakes hold a torque robot without servos.
        let servos = if servos.is_empty() { ArmConfig::unused_servos(self.robot.model.n()) } else { servos };
        Ok(ArmConfig {
            model: self.robot.model.clone(),
            joints: self.robot.joints(),
            servos,
            profile: self.profile.clone(),
            simulated,
            capabilities: self.capabilities().simulated(),
            capsules: self.robot.capsules().to_vec(),
            external_forces: false,
            environment: self.task.file.environment.clone().into_iter().collect(),
            start: self.start()?,
            rest_s: self.robot.file.safety.tare_s.get(),
            seed: self.seed(),
        })
    }

    /// Capabilities of the robot according to robot.toml, with the selected command interface. In addition to the
    /// interface that robot.toml declares, any arm can be simulated as a torque or velocity robot.
    #[must_use]
    pub fn capabilities(&self) -> Capabilities {
        self.robot.capabilities(self.command_kind(), self.profile.period_s())
    }

    /// Builds the control loop of the experiment, before its first cycle.
    ///
    /// # Errors
    /// A servo that the transformer cannot invert.
    pub fn control_loop(&self) -> Result<ControlLoop, FileError> {
        self.control_loop_for(false)
    }

    /// Returns the control loop for a robot that reports a status in each sample, or does not: no file states it.
    pub(super) fn control_loop_for(&self, reports_status: bool) -> Result<ControlLoop, FileError> {
        let mut config = self.loop_config()?;
        config.capabilities.reports_status = reports_status;
        ControlLoop::new(config)
            .map_err(|e: LoopError| FileError::of_file(self.robot.source.name(), e.to_string(), None))
    }

    /// Returns the configuration of the control loop.
    ///
    /// # Errors
    /// A servo that the transformer cannot invert.
    pub fn loop_config(&self) -> Result<LoopConfig, FileError> {
        let joints = self.robot.joints();
        let friction = &self.task.file.friction_compensation;
        Ok(LoopConfig {
            model: self.robot.model.clone(),
            capabilities: self.capabilities(),
            controller: self.controller()?,
            transformer: self.transformer()?,
            servo_gains: self.servo_gains()?,
            setpoint_limits: self.setpoint_limits(),
            estimator: self.profile.estimator.clone(),
            sensors: self.sensor_compensation(),
            estimated_forces: self.estimated_forces(&joints),
            collision: self.collision_detector(),
            friction_observer: friction.observer_rad_per_s.map(|corner_rad_per_s| {
                FrictionObserver::new(joints.len(), corner_rad_per_s, friction.observer_limit_nm)
            }),
            unsensed_contact: self.options.allow.contains(&Code::FrictionObserverWithoutSensor),
            command_delay_s: f64::from(self.profile.delay()) * self.profile.servo_period_s(),
            friction: FrictionCompensation::new(joints.iter().map(|j| &j.friction), friction),
            torque_limits: self.robot.torque_limits(),
            safety: self.robot.file.safety.clone(),
        })
    }

    /// Detector of collisions that robot.toml asks for.
    pub fn collision_detector(&self) -> Option<CollisionDetector> {
        let parameters = self.robot.file.collision_detection.as_ref()?;
        let friction: Vec<_> = self.robot.joints().into_iter().map(|joint| joint.friction).collect();
        Some(CollisionDetector::new(parameters, &friction, &self.robot.torque_limits()))
    }

    fn sensor_compensation(&self) -> Vec<SensorCompensation> {
        let sensors = self.robot.file.force_sensor.values();
        let period_s = self.profile.period_s();
        sensors
            .map(|sensor| {
                let compensation =
                    SensorCompensation::new(sensor.load.as_ref(), sensor.estimate.as_ref(), period_s);
                sensor.bias.iter().fold(compensation, SensorCompensation::with_bias)
            })
            .collect()
    }

    fn estimated_forces(&self, joints: &[JointParameters]) -> Vec<EstimatedForce> {
        let RobotDefinition { file, sensors, .. } = &self.robot;
        let frames = sensors[file.force_sensor.len()..].iter().map(|(_, frame)| *frame);
        let estimated = file.estimated_force.iter().zip(frames);
        let friction = || joints.iter().map(|joint| &joint.friction);
        estimated.map(|((name, force), frame)| EstimatedForce::new(name, frame, force, friction())).collect()
    }

    /// Command interface of the robot in this experiment.
    #[must_use]
    pub fn command_kind(&self) -> CommandKind {
        self.options.backend
    }

    pub(super) fn gravity_compensated_by(&self) -> GravityCompensation {
        self.robot.file.interface.gravity_compensated_by
    }

    fn servo_lead(&self) -> Result<ServoLead, FileError> {
        let gains = self.servo_gains()?;
        Ok(ServoLead {
            kp_per_s: gains.iter().map(ServoGains::position_loop).collect(),
            stiffness_nm_per_rad: gains.iter().map(|servo| servo.stiffness).collect(),
        })
    }

    /// Checks that the robot has the masses that its control and its simulation need: inverse kinematics of a real arm needs none.
    fn check_masses(&self) -> Result<(), FileError> {
        let is_simulated = self.robot.file.driver.is_none();
        if self.options.controller == ControllerKind::Osc || is_simulated {
            self.robot.require_masses()?;
        }
        Ok(())
    }

    fn check_choice(&self) -> Result<(), FileError> {
        let (backend, controller) = (self.options.backend, self.options.controller);
        if backend != CommandKind::Position && controller != ControllerKind::Osc {
            let message = format!(
                "controller '{}' commands positions, which a {} robot does not accept",
                controller.name(),
                backend.name()
            );
            let help = Some("use --backend position, or --controller osc".to_owned());
            return Err(FileError::of_file(self.task.source.name(), message, help));
        }
        if backend != CommandKind::Torque && self.robot.file.interface.command == CommandKind::Torque {
            let message = format!("this robot accepts torques, but a {} robot is requested", backend.name());
            let help = Some("use --backend torque".to_owned());
            return Err(FileError::at_key(&self.robot.source, "interface.command", message, help));
        }
        let interface = &self.robot.file.interface;
        let honoured = MissedCycle::of(interface.command);
        if interface.on_missed_cycle.is_some_and(|stated| stated != honoured) {
            let message = format!(
                "a {} robot does not have this behaviour on a missed cycle",
                interface.command.name()
            );
            let help = Some(format!("omit it, or use \"{}\"", missed_cycle_name(honoured)));
            return Err(FileError::at_key(&self.robot.source, "interface.on_missed_cycle", message, help));
        }
        if interface.command == CommandKind::Torque && interface.on_stop == Some(StopMethod::Setpoints) {
            let message = "a torque robot accepts no setpoints that come to rest";
            let help = Some("omit it, or use \"robot\"".to_owned());
            return Err(FileError::at_key(&self.robot.source, "interface.on_stop", message, help));
        }
        self.servos()?;
        if let Some(name) = self.transformer_name() {
            self.check_transformer(&name)?;
        }
        let counted_s = self.duration_s() - self.task.file.settle_s.get();
        if counted_s > 0.0 && counted_s < self.profile.period_s() {
            let message = format!(
                "{} s of control after settling is shorter than one cycle of {} s",
                counted_s,
                self.profile.period_s()
            );
            return Err(FileError::at_key(&self.task.source, "duration_s", message, None));
        }
        if counted_s <= 0.0 {
            let message = format!(
                "settle_s = {} is not shorter than the run of {} s",
                self.task.file.settle_s.get(),
                self.duration_s()
            );
            let help = Some("increase the duration, or reduce settle_s".to_owned());
            return Err(FileError::at_key(&self.task.source, "settle_s", message, help));
        }
        Ok(())
    }

    /// Refuses a friction observer on a robot that cannot tell contact from friction.
    fn check_friction_observer(&mut self) -> Result<(), FileError> {
        let observes_friction = self.task.file.friction_compensation.observer_rad_per_s.is_some();
        if !observes_friction || !self.robot.file.force_sensor.is_empty() {
            return Ok(());
        }
        let message = "the friction observer needs a force sensor, which this robot does not have: it would oppose all \
                       contact as if it were friction";
        let help = "omit observer_rad_per_s, or add [force_sensor.NAME] if the robot has one".to_owned();
        let key = "friction_compensation.observer_rad_per_s";
        let found = FileError::at_key(&self.task.source, key, message, Some(help));
        self.refuse(found.refused(Code::FrictionObserverWithoutSensor))
    }

    /// Start positions of the joints (n; rad or m), in joint order.
    pub fn start(&self) -> Result<Vec<f64>, FileError> {
        let model = &self.robot.model;
        let mut start = vec![0.0; model.n()];
        for (name, &value) in &self.task.file.start_rad {
            let at = |message, help| {
                FileError::at_key(&self.task.source, ["start_rad", name.as_str()], message, help)
            };
            let joint = model.joint(name).map_err(|unknown| {
                at(format!("this robot has no joint '{name}'"), Some(choices(name, &unknown.known)))
            })?;
            start[joint] = value;
            let Err((message, help)) = check_start(&model.joints()[joint].limits, value) else { continue };
            let given = &self.task.file.start_rad;
            let others = others_outside(model, given, name);
            let help = if are_degrees(model, given) { format!("{help}; {IN_DEGREES}") } else { help };
            return Err(at(format!("{message}{others}"), Some(help)));
        }
        for (joint, &value) in model.joints().iter().zip(&start) {
            if value < joint.limits.lower || value > joint.limits.upper {
                let (lower, upper) = (joint.limits.lower, joint.limits.upper);
                let message = format!(
                    "joint '{}' has no start position, and the default of 0 is outside its limits",
                    joint.name
                );
                let help = Some(format!("add `{} = ...`, from {lower} to {upper}", joint.name));
                return Err(FileError::at_key(&self.task.source, "start_rad", message, help));
            }
        }
        Ok(start)
    }

    fn control_error(&self, error: &ControlError) -> FileError {
        let (message, help) = explained(error);
        FileError::at_key(&self.task.source, error.key(), message, help)
    }

    /// Error for a task set that is incompatible with the robot after an event.
    fn event_error(&self, number: usize, error: &ControlError) -> FileError {
        let (message, help) = explained(error);
        let message = format!("after this event, `{}`: {message}", error.key());
        FileError::at_key(&self.task.source, ["event", &number.to_string(), "set"], message, help)
    }

    fn plant_error(&self, error: &PlantError) -> FileError {
        let file = error.file.as_ref().map(|file| file.display().to_string());
        FileError::of_file(file.as_deref().unwrap_or(self.robot.source.name()), &*error.message, None)
    }

    /// Error for a log of a physics engine, which is simulated again.
    fn missing_engine(&self) -> FileError {
        let message =
            format!("the log was simulated by {}, which this experiment does not have", self.plant());
        let help = Some("pass the engine to Experiment::on_engine".to_owned());
        FileError::of_file(self.task.source.name(), message, help)
    }

    fn simulation_error(&self, error: &SimulationError) -> FileError {
        if let SimulationError::Plant(error) = error {
            return self.plant_error(error);
        }
        let help = match error {
            SimulationError::Frame { source, .. } => Some(choices(&source.name, &source.known)),
            _ => None,
        };
        let message = match error {
            SimulationError::Frame { source, .. } => format!("this robot has no frame '{}'", source.name),
            other => other.to_string(),
        };
        match error.key() {
            Key::Robot(key) => FileError::at_key(&self.robot.source, key, message, help),
            Key::Profile(within) => {
                let mut key = vec!["profile".to_owned(), self.profile_name.clone()];
                key.extend(within);
                FileError::at_key(&self.robot.source, key, message, help)
            }
            Key::Task(mut key) => {
                // The table of the kind lies between the name and the key.
                if let Some(object) = key.get(1).and_then(|name| self.task.file.environment.get(name)) {
                    key.insert(2, object.kind().to_owned());
                }
                FileError::at_key(&self.task.source, key, message, help)
            }
            // A file of several robots has no place in an experiment of one.
            Key::Simulation(_) => FileError::of_file(self.task.source.name(), message, help),
        }
    }
}

/// Name of the behaviour as in robot.toml.
fn missed_cycle_name(behaviour: MissedCycle) -> &'static str {
    match behaviour {
        MissedCycle::HoldLast => "hold-last",
        MissedCycle::HoldTorque => "hold-torque",
    }
}

/// Returns a message for a mistake in a task, and a suggestion if there is one.
fn explained(error: &ControlError) -> (String, Option<String>) {
    let help = match error.reason() {
        Reason::Frame(unknown) => Some(choices(&unknown.name, &unknown.known)),
        Reason::Joint(unknown) => Some(choices(&unknown.name, &unknown.known)),
        Reason::Sensor { name, known } | Reason::UnknownTask { name, known } => Some(choices(name, known)),
        _ => None,
    };
    let message = match error.reason() {
        Reason::Frame(unknown) => format!("this robot has no frame '{}'", unknown.name),
        Reason::Joint(unknown) => format!("this robot has no joint '{}'", unknown.name),
        Reason::Sensor { name, .. } => format!("this robot has no force sensor '{name}'"),
        Reason::UnknownTask { name, .. } => format!("there is no task '{name}'"),
        other => other.to_string(),
    };
    (message, help)
}
