//! Experiments with the files embedded in the program, run in memory.

#![allow(dead_code, reason = "each test uses some of it")]

use opspace_backend::{Backend, CommandKind, GroundTruth, Layout, Observable, SignalRecorder, Sink};
use opspace_control::{ControlInput, Controller, Measurement};
use opspace_experiment::evaluate::metrics::metrics;
use opspace_experiment::{
    ControllerKind, Experiment, Extensions, Files, Metrics, RobotDefinition, RunOptions, TaskDefinition,
};
use opspace_log::Recording;
use opspace_log::recording::{ChannelData, Column};
use opspace_loop::{ControlLoop, LoopConfig, Run as LoopRun, RunOutcome};
use opspace_model::Data;
use opspace_transformer::TransformerName;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

pub const ROBOT: &str = "robots/asimo-arm";

/// Options of a position robot with operational-space control in a profile.
pub fn osc(profile: &str) -> RunOptions {
    let transformer = Some(TransformerName::from("paper"));
    RunOptions { profile: Some(profile.to_owned()), transformer, ..RunOptions::default() }
}

/// Options of a torque robot with the rates of a profile.
pub fn torque(profile: &str) -> RunOptions {
    RunOptions { backend: CommandKind::Torque, ..osc(profile) }
}

/// Options of a position robot with inverse kinematics, with or without velocity lead.
pub fn ik(profile: &str, controller: ControllerKind) -> RunOptions {
    RunOptions { controller, ..osc(profile) }
}

pub fn robot(settings: &[&str]) -> RobotDefinition {
    RobotDefinition::load(Files::Embedded, Path::new(ROBOT), &owned(settings))
        .unwrap_or_else(|e| panic!("{e}"))
}

pub fn task(name: &str, settings: &[&str]) -> TaskDefinition {
    let path = format!("tasks/{name}.toml");
    let extensions = Extensions::default().with_comparisons();
    TaskDefinition::load_with(&extensions, Files::Embedded, Path::new(&path), &owned(settings))
        .unwrap_or_else(|e| panic!("{e}"))
}

pub fn experiment(robot: RobotDefinition, task: TaskDefinition, options: RunOptions) -> Experiment {
    Experiment::new(robot, task, options, Vec::new()).unwrap_or_else(|e| panic!("{e}"))
}

/// Loads a task of the paper on its robot, with settings as on the command line.
pub fn load(name: &str, options: RunOptions, settings: &[&str]) -> Experiment {
    let path = format!("tasks/{name}.toml");
    Experiment::load(Files::Embedded, Path::new(&path), None, options, &owned(settings))
        .unwrap_or_else(|e| panic!("{e}"))
}

fn owned(settings: &[&str]) -> Vec<String> {
    settings.iter().map(|s| (*s).to_owned()).collect()
}

/// Returns the robot with ideal drives: without current loop, encoder quantisation, noise and torque limit.
pub fn ideal(mut robot: RobotDefinition) -> RobotDefinition {
    let simulated = robot.file.simulated.as_mut().expect("the arm can be simulated");
    simulated.current_loop_hz = None;
    simulated.encoder_quantisation = false;
    simulated.torque_noise_nm = Default::default();
    simulated.torque_saturation = false;
    robot
}

/// Outcome of a run, and its rows.
pub struct Run {
    pub ending: RunOutcome,
    pub recording: Recording,
}

impl Run {
    pub fn channel(&self, channel: &str) -> &ChannelData {
        self.recording.channel(channel).unwrap_or_else(|| panic!("no channel {channel}"))
    }

    pub fn signal(&self, channel: &str, signal: &str) -> Column<'_> {
        self.channel(channel).signal(signal).unwrap_or_else(|| panic!("no signal {channel}/{signal}"))
    }
}

/// Sink that stores the rows in memory.
pub struct Memory {
    pub recording: Recording,
    /// Number of cycles after which the interrupt flag is set.
    pub interrupt_after: Option<u64>,
    ticks: u64,
}

impl Memory {
    pub fn new(layouts: Vec<Layout>) -> Self {
        let empty = |layout| ChannelData { layout, time_s: Vec::new(), rows: Vec::new() };
        let channels = layouts.into_iter().map(empty).collect();
        Self { recording: Recording { channels, ..Recording::default() }, interrupt_after: None, ticks: 0 }
    }
}

/// A [`Memory`] with the interrupt flag that it sets.
struct Flagged<'a>(&'a mut Memory, &'a AtomicBool);

impl Sink for Flagged<'_> {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        let data = &mut self.0.recording.channels[channel];
        data.time_s.push(time_s);
        data.rows.extend_from_slice(row);
    }

    fn between_ticks(&mut self) {
        self.0.ticks += 1;
        if self.0.interrupt_after == Some(self.0.ticks) {
            self.1.store(true, Ordering::Relaxed);
        }
    }
}

/// Runs an experiment with the controller of its task.
pub fn run(experiment: &Experiment) -> Run {
    let controller = experiment.controller().unwrap_or_else(|e| panic!("{e}"));
    run_with(experiment, controller, None)
}

/// Runs an experiment and returns its metrics.
pub fn measure(experiment: &Experiment) -> Metrics {
    let run = run(experiment);
    assert_eq!(run.ending, RunOutcome::Completed, "{}", experiment.task().name());
    metrics(experiment, &run.recording)
}

/// Runs a given controller on the simulated robot of an experiment, optionally interrupted after some cycles.
pub fn run_with(
    experiment: &Experiment,
    controller: Box<dyn Controller>,
    interrupt_after: Option<u64>,
) -> Run {
    let mut arm = experiment.simulated_arm().unwrap_or_else(|e| panic!("{e}"));
    let control = control_loop(experiment, controller);
    let truth = arm.ground_truth().map(GroundTruth::layouts);
    let mut memory = Memory { interrupt_after, ..Memory::new(LoopRun::layouts(&control, truth)) };
    let interrupt = AtomicBool::new(false);
    let mut flagged = Flagged(&mut memory, &interrupt);
    let mut run = LoopRun::new(control, experiment.duration_s(), &mut flagged).with_stop_request(&interrupt);
    opspace_loop::drive(&mut arm, &mut run);
    let ending = run.finish();
    Run { ending, recording: memory.recording }
}

/// Builds the control loop of an experiment with another controller.
pub fn control_loop(experiment: &Experiment, controller: Box<dyn Controller>) -> ControlLoop {
    let config = experiment.loop_config().unwrap_or_else(|e| panic!("{e}"));
    ControlLoop::new(LoopConfig { controller, ..config }).unwrap_or_else(|e| panic!("{e}"))
}

/// Controller whose commands are computed by a function of the test.
pub struct Told<F> {
    pub kind: CommandKind,
    pub command: F,
}

impl<F: FnMut(&Data, &Measurement, &mut [f64]) + Send> Controller for Told<F> {
    fn command_kind(&self) -> CommandKind {
        self.kind
    }

    fn start(&mut self, _input: &ControlInput<'_>) {}

    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]) {
        (self.command)(input.data, input.measurement, command);
    }
}

impl<F> Observable for Told<F> {
    fn record(&self, _out: &mut SignalRecorder<'_>) {}
}

/// Creates a torque controller from a function.
pub fn torques<F: FnMut(&Data, &Measurement, &mut [f64]) + Send>(command: F) -> Told<F> {
    Told { kind: CommandKind::Torque, command }
}

/// Creates a position controller from a function.
pub fn positions<F: FnMut(&Data, &Measurement, &mut [f64]) + Send>(command: F) -> Told<F> {
    Told { kind: CommandKind::Position, command }
}
