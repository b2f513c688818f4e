//! Companion of a run: enters the inputs that the node of the task receives, between two cycles.

use crate::clutch::Clutch;
use crate::config::{DRIVER, InterfaceConfig, NodePlace};
use crate::frames::{FrameRef, Frames};
use crate::inputs::Input;
use crate::interface::{Interface, InterfacePlan, TaskTopics};
use crate::node::Participants;
use crate::outputs::{OutputPlan, Outputs};
use crate::tare::Tare;
use nalgebra::Vector3;
use opspace_backend::{CommandKind, DriverError, Setting, Settings};
use opspace_control::{AxisMode, CartesianReference, CartesianTarget, TaskParameters};
use opspace_experiment::{Companion, CompanionEntry, Experiment, FileError, Progress, RunError, Scenario};
use opspace_log::ViewerReceiver;
use opspace_loop::Run;
use opspace_model::{Data, FrameId, Model, Placement, frame_placement, kinematics};
use rtrb::{Consumer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Number of inputs that wait for a cycle.
const INPUTS: usize = 64;

/// Key of `[driver]` that names the driver.
const NAME: &str = "name";

/// Companion of a run with robots behind topics.
pub struct RosCompanion {
    /// Inputs of each robot; `None` for those without topics.
    robots: Vec<Option<RobotInputs>>,
}

/// Inputs of one robot.
struct RobotInputs {
    inputs: Consumer<Input>,
    interface: Interface,
    outputs: Option<Outputs>,
    tasks: Vec<TaskInput>,
    model: Model,
    data: Data,
    dq: Vec<f64>,
    has_begun: bool,
}

/// Inputs of one task.
struct TaskInput {
    name: String,
    frame: FrameId,
    /// Its target, once the run has begun; `None` for a task without inputs.
    target: Option<CartesianTarget>,
    clutch: Clutch,
    wrench: Option<[f64; 6]>,
    gains: Option<([f64; 6], [f64; 6])>,
    modes: [Option<AxisMode>; 6],
}

/// Returns the entry of the companion for [`Extensions`](opspace_experiment::Extensions).
#[must_use]
pub fn entry(participants: Participants, tare: Tare) -> CompanionEntry {
    CompanionEntry::new(DRIVER, move |scenario, progress| open(&participants, &tare, scenario, progress))
}

fn open(
    participants: &Participants,
    tare: &Tare,
    scenario: &Scenario,
    progress: &Progress,
) -> Result<Option<Box<dyn Companion>>, RunError> {
    let robot = |experiment: &Experiment| {
        open_robot(participants, tare, experiment, progress).map_err(|error| mistake(experiment, &error))
    };
    let robots = scenario.experiments().map(robot).collect::<Result<Vec<_>, _>>()?;
    let is_needed = robots.iter().any(Option::is_some);
    Ok(is_needed.then(|| Box::new(RosCompanion { robots }) as Box<dyn Companion>))
}

fn open_robot(
    participants: &Participants,
    tare: &Tare,
    experiment: &Experiment,
    progress: &Progress,
) -> Result<Option<RobotInputs>, DriverError> {
    let Some(settings) = settings(experiment) else { return Ok(None) };
    let Some(config) = InterfaceConfig::from_settings(&settings)? else { return Ok(None) };
    let place = NodePlace::from_settings(&settings)?;
    let model = experiment.robot().model.clone();
    let tasks = cartesian_tasks(experiment);
    let topics = tasks
        .iter()
        .map(|(name, _, is_streamed)| TaskTopics { name: name.clone(), is_streamed: *is_streamed });
    let plan = InterfacePlan {
        place: place.clone(),
        config: config.clone(),
        tasks: topics.collect(),
        task_sets: 1 + experiment.task().events.len() as u32,
        frames: Frames::new(model.clone()),
        interrupt: Arc::clone(&progress.interrupt),
        tare: tare.clone(),
    };
    let (sender, inputs) = RingBuffer::new(INPUTS);
    let interface = Interface::start(participants, plan, sender)?;
    let outputs = OutputPlan {
        place,
        config,
        tasks: tasks.iter().map(|(name, ..)| name.clone()).collect(),
        sensors: experiment.capabilities().force_sensors,
        base: model.frames().first().map(|frame| frame.name.clone()).unwrap_or_default(),
        robot: experiment.robot().name().to_owned(),
        period_s: experiment.profile().1.period_s(),
        counts: Arc::clone(&interface.counts),
    };
    let outputs = Outputs::open(participants, outputs)?;
    let input = |(name, frame, _): (String, String, bool)| {
        Some(TaskInput {
            frame: model.frame_id(&frame).ok()?,
            name,
            target: None,
            clutch: Clutch::default(),
            wrench: None,
            gains: None,
            modes: [None; 6],
        })
    };
    let tasks = tasks.into_iter().filter_map(input).collect();
    let (data, dq) = (Data::new(&model), vec![0.0; model.n()]);
    Ok(Some(RobotInputs {
        inputs,
        interface,
        outputs: Some(outputs),
        tasks,
        model,
        data,
        dq,
        has_begun: false,
    }))
}

/// Settings of `[driver]` of a robot behind topics.
fn settings(experiment: &Experiment) -> Option<Settings> {
    let keys = experiment.robot().file.driver.as_ref()?;
    if !matches!(keys.get(NAME), Some(Setting::Text(name)) if name == DRIVER) {
        return None;
    }
    let none = Settings::new(CommandKind::Position, Vec::new(), experiment.profile().1.period_s());
    let keys = keys.iter().filter(|(key, _)| *key != NAME);
    Some(keys.fold(none, |settings, (key, value)| settings.with(key, value.clone())))
}

/// Names and frames of the Cartesian tasks, and whether their references are streamed.
fn cartesian_tasks(experiment: &Experiment) -> Vec<(String, String, bool)> {
    let tasks = experiment.task().file.task.iter();
    let cartesian = tasks.filter_map(|(name, parameters)| match parameters {
        TaskParameters::Cartesian(task) => {
            let is_streamed = matches!(task.reference, CartesianReference::Streamed(_));
            Some((name.clone(), task.frame.clone(), is_streamed))
        }
        _ => None,
    });
    cartesian.collect()
}

fn mistake(experiment: &Experiment, error: &DriverError) -> RunError {
    let source = &experiment.robot().source;
    let key = error.key.as_ref().map(|key| vec!["driver".to_owned(), key.clone()]);
    let key = key.unwrap_or_else(|| vec!["driver".to_owned()]);
    FileError::at_key(source, key, error.words.clone(), None).into()
}

impl Companion for RosCompanion {
    fn receivers(&mut self, robot: usize) -> Vec<Box<dyn ViewerReceiver>> {
        let outputs =
            self.robots.get_mut(robot).and_then(Option::as_mut).and_then(|robot| robot.outputs.take());
        outputs.into_iter().map(|outputs| Box::new(outputs) as Box<dyn ViewerReceiver>).collect()
    }

    fn before_cycle(&mut self, robot: usize, _time_s: f64, run: &mut Run<'_>) -> bool {
        if let Some(Some(robot)) = self.robots.get_mut(robot) {
            robot.apply(run);
        }
        true
    }
}

impl RobotInputs {
    /// Enters what has arrived since the last cycle. Only the first call allocates.
    fn apply(&mut self, run: &mut Run<'_>) {
        if !std::mem::replace(&mut self.has_begun, true) {
            let targets = run.targets();
            self.interface.counts.has_no_inputs.store(targets.row().is_empty(), Ordering::Relaxed);
            for task in &mut self.tasks {
                task.target = CartesianTarget::of(targets, &task.name).ok();
            }
        }
        let mut has_kinematics = false;
        while let Ok(input) = self.inputs.pop() {
            if !std::mem::replace(&mut has_kinematics, true) {
                kinematics(&self.model, &mut self.data, run.control().measurement().q.as_slice(), &self.dq);
            }
            let is_good = self.enter(input, run);
            if !is_good {
                self.interface.counts.refused.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Enters an input; returns false if its task does not take it.
    fn enter(&mut self, input: Input, run: &mut Run<'_>) -> bool {
        let task = match input {
            Input::Hold(hold) => {
                run.targets().hold(hold);
                return true;
            }
            Input::TaskSet(number) => {
                run.targets().choose_task_set(number);
                return true;
            }
            Input::Pose(task, ..)
            | Input::Twist(task, ..)
            | Input::Wrench(task, ..)
            | Input::Gains(task, ..)
            | Input::Modes(task, ..)
            | Input::Clutch(task, ..) => task,
        };
        let Self { tasks, model, data, .. } = self;
        let Some(task) = tasks.get_mut(task) else { return false };
        let at = |frame: FrameRef| {
            frame.frame.map_or(frame.offset, |id| frame_placement(model, data, id) * frame.offset)
        };
        let own = frame_placement(model, data, task.frame);
        let Some(target) = &mut task.target else { return false };
        let is_good = match input {
            Input::Clutch(_, is_closed) => {
                task.clutch.set(is_closed);
                return true;
            }
            Input::Pose(_, frame, pose) => match task.clutch.target(&(at(frame) * pose), &own) {
                None => return true,
                Some(placement) => target.placement(&placement).is_ok(),
            },
            Input::Twist(_, frame, twist) => {
                // Without a pose the reference goes on from where it is.
                target.clear();
                let kept = [
                    task.wrench.is_none_or(|wrench| target.wrench(wrench).is_ok()),
                    task.gains.is_none_or(|(frequency, ratio)| target.gains(frequency, ratio).is_ok()),
                    target.modes(task.modes).is_ok(),
                ];
                kept == [true; 3] && target.twist(rotated(&at(frame), twist)).is_ok()
            }
            Input::Wrench(_, wrench) => {
                let is_good = target.wrench(wrench).is_ok();
                task.wrench = if is_good { Some(wrench) } else { task.wrench };
                is_good
            }
            Input::Gains(_, frequency, ratio) => {
                let is_good = target.gains(frequency, ratio).is_ok();
                task.gains = if is_good { Some((frequency, ratio)) } else { task.gains };
                is_good
            }
            Input::Modes(_, modes) => {
                let is_good = target.modes(modes).is_ok();
                task.modes = if is_good { modes } else { task.modes };
                is_good
            }
            Input::Hold(_) | Input::TaskSet(_) => true,
        };
        let clock_s = run.control().clock_s();
        is_good && target.write(run.targets(), clock_s).is_ok()
    }
}

/// Velocities in the axes of the world, from those in the axes of a frame.
fn rotated(frame: &Placement, twist: [f64; 6]) -> [f64; 6] {
    let [a, b, c, d, e, f] = twist;
    let linear = frame.rotation * Vector3::new(a, b, c);
    let angular = frame.rotation * Vector3::new(d, e, f);
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}
