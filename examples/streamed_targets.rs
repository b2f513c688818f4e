//! Cartesian targets from another thread at 100 Hz, with a pause in which they become stale.
//!
//! `cargo run --release -p opspace --example streamed_targets` runs for 4 s of real time, writes to
//! `runs/streamed_targets`, and replays it: targets are logged inputs.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::backend::{Backend, Capabilities, Command, DeviceFault, GroundTruth, Sample};
use opspace::control::CartesianTarget;
use opspace::control_loop::{TargetSender, drive, target_stream};
use opspace::experiment::{Experiment, Files, Progress};
use opspace::log::Recording;
use opspace::model::{Data, frame_placement, kinematics};
use opspace::sim::SimulatedArm;
use std::thread;
use std::time::{Duration, Instant};

/// Simulated arm that runs in real time, as a robot does.
struct Paced(SimulatedArm, Instant);

impl Backend for Paced {
    fn capabilities(&self) -> &Capabilities {
        self.0.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        let period_s = self.capabilities().period_s;
        self.1 += Duration::from_secs_f64(period_s);
        thread::sleep(self.1.saturating_duration_since(Instant::now()));
        self.0.read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.0.write(command)
    }

    fn stop(&mut self) {
        self.0.stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        self.0.ground_truth()
    }
}

/// Streams a circle of 5 cm about `centre` (m), with a pause from 1.5 to 2.5 s.
fn stream(mut sender: TargetSender, centre: [f64; 3]) {
    let mut target =
        CartesianTarget::of(sender.targets(), "hand").expect("the hand has a streamed reference");
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(5) {
        let t = begun.elapsed().as_secs_f64();
        if !(1.5..2.5).contains(&t) {
            let (sin, cos) = (2.0 * t).sin_cos();
            let position = [centre[0], centre[1] + 0.05 * sin, centre[2] + 0.05 * (1.0 - cos)];
            target.position(position).expect("a finite position");
            target.twist([0.0, 0.1 * cos, 0.1 * sin, 0.0, 0.0, 0.0]).expect("a finite velocity");
            // If the ring is full, this target is dropped; the next one follows soon.
            let _ = sender.send(target.task(), &target.inputs());
        }
        thread::sleep(Duration::from_millis(10));
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = "examples/tasks/streamed.toml".as_ref();
    let experiment = Experiment::load(Files::Disk, task, None, Default::default(), &[])?;
    let model = &experiment.robot().model;
    let mut data = Data::new(model);
    kinematics(model, &mut data, &[-0.45, -0.35, 0.25, -1.35], &[0.0; 4]);
    let centre = frame_placement(model, &data, model.frame_id("hand")?).translation;

    let arm = experiment.simulated_arm()?;
    let (capabilities, truth) = (arm.capabilities().clone(), arm.ground_truth().map(GroundTruth::layouts));
    common::record("streamed_targets", &experiment, |log| {
        experiment.run_with(&capabilities, truth, log, &Progress::default(), |run| {
            let (sender, receiver) = target_stream(run.targets());
            run.set_target_stream(receiver);
            thread::spawn(move || stream(sender, centre.into()));
            drive(&mut Paced(arm, Instant::now()), run);
        })
    })?;
    let recording = Recording::read("runs/streamed_targets/run.mcap")?;
    let stale = recording.tick()?.signal("hand.target_stale").ok_or("staleness is logged")?;
    println!("cycles with a stale target: {}", stale.rows().filter(|row| row[0] == 1.0).count());
    Ok(())
}
