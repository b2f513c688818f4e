//! A robot whose encoders count within one turn, and whose drives take positions within one turn.

use crate::cli_common::project;
use crate::common::{Memory, Run};
use opspace_backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, GroundTruth, Sample, Sink};
use opspace_experiment::run::replay::replay;
use opspace_experiment::{Experiment, Files, RunOptions};
use opspace_loop::{Run as LoopRun, RunOutcome};
use opspace_model::JointKind;
use opspace_sim::SimulatedArm;
use std::f64::consts::{PI, TAU};
use std::path::Path;

/// Simulated arm behind encoders that count from -π to π.
struct WithinTurn {
    arm: SimulatedArm,
    /// Positions of the arm at the last sample, rad (n).
    q: Vec<f64>,
}

/// The angle within half a turn on either side of zero, rad.
fn within_turn(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

impl Backend for WithinTurn {
    fn capabilities(&self) -> &Capabilities {
        self.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.arm.read(sample)?;
        self.q.clone_from(&sample.q);
        sample.q.iter_mut().for_each(|q| *q = within_turn(*q));
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        match command {
            // The drive moves the shortest way to a position within the turn.
            Command::Position(setpoints) => {
                let pairs = setpoints.iter().zip(&self.q);
                let near = pairs.map(|(&q, &at)| JointKind::Continuous.nearest_turn(within_turn(q), at));
                self.arm.write(Command::Position(&near.collect::<Vec<f64>>()))
            }
            other => self.arm.write(other),
        }
    }

    fn stop(&mut self) {
        self.arm.stop();
    }
}

/// Turns the shoulder of the planar arm from 3.0 to -3.0 rad, the short way, and on by two radians.
fn experiment(backend: CommandKind) -> Experiment {
    let settings = [
        "robot.simulated.encoder_quantisation=false",
        "start_rad={ shoulder = 3.0, elbow = -3.0 }",
        "priority=[\"arm\"]",
        "task={ arm = { joint-tracking = { gains = { frequency_rad_per_s = 15.0, damping_ratio = 1.0 }, reference = { waypoints = [\
         { time_s = 1.0, goal = { absolute_rad = { shoulder = -3.0, elbow = 3.0 } } }, \
         { time_s = 3.0, goal = { absolute_rad = { shoulder = -1.0 } } }] } } } }",
    ];
    let path = project("tasks/planar-2-link-reach.toml");
    let options = RunOptions { backend, duration_s: Some(3.5), ..RunOptions::default() };
    Experiment::load(Files::Disk, Path::new(&path), None, options, &settings.map(str::to_owned))
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Sink that keeps the rows.
struct Rows(Memory);

impl Sink for Rows {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        let data = &mut self.0.recording.channels[channel];
        data.time_s.push(time_s);
        data.rows.extend_from_slice(row);
    }
}

/// Runs an experiment on a robot.
fn run_on(experiment: &Experiment, robot: &mut dyn Backend) -> Run {
    let control = experiment.control_loop().unwrap_or_else(|error| panic!("{error}"));
    let truth = robot.ground_truth().map(GroundTruth::layouts);
    let mut memory = Rows(Memory::new(LoopRun::layouts(&control, truth)));
    let mut run = LoopRun::new(control, experiment.duration_s(), &mut memory);
    opspace_loop::drive(robot, &mut run);
    let ending = run.finish();
    assert_eq!(ending, RunOutcome::Completed);
    Run { ending, recording: memory.0.recording }
}

/// Compared: positions, torques and setpoints of a run on encoders within a turn, and on encoders that go on; the end of the motion
/// and the goal, the short way; and the run and its replay, bit for bit. On position and torque robots.
#[test]
fn run_goes_on_beyond_the_turn() {
    for backend in [CommandKind::Position, CommandKind::Torque] {
        let experiment = experiment(backend);
        let arm = || experiment.simulated_arm().unwrap_or_else(|error| panic!("{error}"));
        let n = experiment.robot().model.n();
        let goes_on = run_on(&experiment, &mut arm());
        let within = run_on(&experiment, &mut WithinTurn { arm: arm(), q: vec![0.0; n] });
        for signal in ["q", "dq", "command", "torque_desired"] {
            let [a, b] = [&goes_on, &within]
                .map(|run| run.signal("tick", signal).rows().flatten().copied().collect::<Vec<_>>());
            assert_eq!(a.len(), b.len());
            let pairs = a.iter().zip(&b).filter(|(a, _)| a.is_finite());
            let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(error < 1e-9, "{backend:?}, {signal}: {error}");
        }
        let end = within.signal("tick", "q").rows().last().map(<[f64]>::to_vec).expect("rows");
        assert!(
            (end[0] - (TAU - 1.0)).abs() < 0.02 && (end[1] - (3.0 - TAU)).abs() < 0.02,
            "{backend:?}: {end:?}"
        );
        let report = replay(&experiment, &within.recording).unwrap_or_else(|error| panic!("{error}"));
        assert!(report.differing == 0 && report.compared > 3000, "{backend:?}: {report:?}");
    }
}

/// Compared: diagnostics of goals that are half a turn away at the start, or from the waypoint before, and of others.
#[test]
fn goal_half_a_turn_away_is_named() {
    let folder = crate::cli_common::scratch();
    let task = |start: f64, goals: &str| {
        let text = format!(
            "robot = \"{}\"\nduration_s = 4.0\npriority = [\"arm\"]\nstart_rad = {{ shoulder = {start:?} }}\n\
             [task.arm.joint-tracking]\ngains = {{ frequency_rad_per_s = 15.0, damping_ratio = 1.0 }}\n\
             reference = {{ waypoints = [{goals}] }}\n",
            project("robots/planar-2-link")
        );
        std::fs::write(folder.path().join("task.toml"), text).expect("it is written");
        crate::cli_common::opspace(folder.path(), &["check", "task.toml"]).exits(0).stdout
    };
    let to = |time_s: f64, q: f64| {
        format!("{{ time_s = {time_s:?}, goal = {{ absolute_rad = {{ shoulder = {q:?} }} }} }}")
    };
    for (start, goals, is_named) in [
        (0.0, to(3.0, PI), true),
        (3.0, to(3.0, 3.0 - PI), true),
        (0.5, to(3.0, PI), false),
        (0.0, format!("{}, {}", to(2.0, 1.0), to(4.0, 1.0 + PI)), true),
        (0.0, format!("{}, {}", to(2.0, 1.0), to(4.0, PI)), false),
    ] {
        let said = task(start, &goals);
        assert_eq!(said.contains("[half-turn]"), is_named, "{start} {goals}: {said}");
    }
}
