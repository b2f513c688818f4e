//! Runs that own their logs, stepped by the caller: the same bits as a run that the library drives.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::project;
use opspace_backend::{Backend, CommandKind, Sample};
use opspace_experiment::run::owned_run::OwnedRun;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::{OutcomeRecord, Recording};
use opspace_loop::RunOutcome;
use opspace_sim::SimulatedArm;
use std::io::Cursor;
use std::sync::atomic::Ordering;
use std::thread;

type Memory = Cursor<Vec<u8>>;

fn experiment(backend: CommandKind) -> Experiment {
    let options = RunOptions { backend, duration_s: Some(1.6), ..RunOptions::default() };
    Experiment::load(Files::Disk, &project("tasks/compliant-x.toml"), None, options, &[]).unwrap()
}

/// Object of a program that is called once per cycle.
struct Stepped {
    arm: SimulatedArm,
    sample: Sample,
    run: OwnedRun<Memory>,
}

impl Stepped {
    fn new(experiment: &Experiment, progress: &Progress) -> Self {
        let arm = experiment.simulated_arm().unwrap();
        let sample = Sample::new(arm.capabilities());
        let log = Cursor::new(Vec::new());
        let run = experiment.start_run(arm.capabilities(), arm.ground_truth(), log, progress).unwrap();
        Self { arm, sample, run }
    }

    /// Computes a cycle; false if the run is over.
    fn step(&mut self) -> bool {
        let run = self.run.run();
        if run.is_over() {
            return false;
        }
        let was_stopped = run.is_stopped();
        self.arm.read(&mut self.sample).unwrap();
        run.record_truth(self.arm.ground_truth().unwrap());
        if let Some(command) = run.cycle(&self.sample) {
            self.arm.write(command).unwrap();
        }
        if run.is_stopped() && !was_stopped {
            self.arm.stop();
        }
        run.between_cycles();
        true
    }
}

fn rows(log: &Memory) -> Vec<(String, Vec<u64>)> {
    let recording = Recording::from_bytes(log.get_ref()).unwrap();
    let channels = recording.channels.iter().filter(|channel| channel.layout.channel != "timing");
    channels.map(|c| (c.layout.channel.clone(), c.rows.iter().map(|x| x.to_bits()).collect())).collect()
}

/// Every cycle on another thread than the one before.
#[test]
fn stepped_on_changing_threads_it_has_the_bits_of_a_driven_run() {
    for backend in [CommandKind::Torque, CommandKind::Position] {
        let experiment = experiment(backend);
        let driven = experiment.run(Memory::default(), &Progress::default()).unwrap();
        let mut stepped = Stepped::new(&experiment, &Progress::default());
        loop {
            let goes_on;
            (stepped, goes_on) = thread::spawn(move || {
                let goes_on = stepped.step();
                (stepped, goes_on)
            })
            .join()
            .unwrap();
            if !goes_on {
                break;
            }
        }
        let finished = stepped.run.finish().unwrap();
        assert_eq!(finished.outcome, RunOutcome::Completed);
        assert_eq!(finished.written.records, driven.written.records);
        let (of_stepped, of_driven) = (rows(&finished.sink), rows(&driven.sink));
        assert_eq!(of_stepped.len(), 3, "tick, truth and servo");
        assert!(of_stepped == of_driven, "{backend:?}");
    }
}

#[test]
fn run_that_is_finished_early_or_stopped_is_interrupted() {
    let experiment = experiment(CommandKind::Position);
    for stops in [false, true] {
        let progress = Progress::default();
        let mut stepped = Stepped::new(&experiment, &progress);
        for _ in 0..50 {
            assert!(stepped.step());
        }
        if stops {
            progress.interrupt.store(true, Ordering::Relaxed);
            while stepped.step() {}
        }
        let finished = stepped.run.finish().unwrap();
        assert!(matches!(finished.outcome, RunOutcome::Interrupted { .. }), "{:?}", finished.outcome);
        let recording = Recording::from_bytes(finished.sink.get_ref()).unwrap();
        assert!(recording.channel("tick").unwrap().len() >= 50);
    }
}

/// Its log has the outcome that `finish` writes: interrupted before the end, completed after it.
#[test]
fn run_that_is_dropped_has_an_outcome_in_its_log() {
    let experiment = experiment(CommandKind::Position);
    let folder = tempfile::tempdir().unwrap();
    for (cycles, interrupted) in [(50, true), (usize::MAX, false)] {
        let path = folder.path().join(format!("{interrupted}.mcap"));
        let mut arm = experiment.simulated_arm().unwrap();
        let file = std::fs::File::create(&path).unwrap();
        let progress = Progress::default();
        let mut owned =
            experiment.start_run(arm.capabilities(), arm.ground_truth(), file, &progress).unwrap();
        let mut sample = Sample::new(arm.capabilities());
        for _ in 0..cycles {
            if owned.run().is_over() {
                break;
            }
            arm.read(&mut sample).unwrap();
            if let Some(command) = owned.run().cycle(&sample) {
                arm.write(command).unwrap();
            }
        }
        drop(owned);
        let recording = Recording::read(&path).unwrap();
        let outcome = OutcomeRecord::of(&recording);
        assert!(recording.closed && recording.metadata("opspace.outcome").is_some());
        assert_eq!((outcome.interrupted, outcome.fault), (interrupted, None));
    }
}

/// The external force of a changed configuration, set by another thread.
#[test]
fn external_force_is_set_from_another_thread() {
    let experiment = experiment(CommandKind::Position);
    let mut config = experiment.arm_config().unwrap();
    config.external_forces = true;
    let arm = experiment.simulated_arm_of(config).unwrap();
    let force = arm.external_force().unwrap();
    let frame = experiment.robot().model.frame_id("hand").unwrap();
    let pull = opspace_sim::Pull::Wrench(opspace_model::Force {
        linear: nalgebra::Vector3::new(3.0, 0.0, 0.0),
        angular: nalgebra::Vector3::zeros(),
    });
    thread::spawn(move || force.apply(frame, pull)).join().unwrap();
    assert!(arm.external_force().unwrap().get().is_some());
}
