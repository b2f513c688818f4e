//! A robot with a callback: its own loop requests a command once per cycle. Log, summary and outcome are the same.
//!
//! `cargo run --release -p opspace --example callback` writes to `runs/callback`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::backend::{Backend, Command, CommandKind, Sample};
use opspace::experiment::{Experiment, Files, Progress, RunOptions};
use opspace::sim::SimulatedArm;

/// Vendor's loop: it controls the timing, and calls the callback until the callback returns `None`.
fn control(arm: &mut SimulatedArm, mut callback: impl FnMut(&Sample) -> Option<Vec<f64>>) {
    let mut sample = Sample::new(arm.capabilities());
    while arm.read(&mut sample).is_ok() {
        match callback(&sample) {
            Some(torque) => arm.write(Command::Torque(&torque)).expect("the arm accepts torques"),
            None if sample.time_s > 0.0 => break,
            // Before control the robot holds itself.
            None => {}
        }
    }
    arm.stop();
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let options = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    let experiment = Experiment::load(Files::Disk, "tasks/compliant-x.toml".as_ref(), None, options, &[])?;
    let mut arm = experiment.simulated_arm()?;
    let capabilities = arm.capabilities().clone();
    common::record("callback", &experiment, |log| {
        experiment.run_with(&capabilities, None, log, &Progress::default(), |run| {
            control(&mut arm, |sample| match run.cycle(sample) {
                Some(Command::Torque(torque)) => Some(torque.to_vec()),
                _ => None,
            });
        })
    })
}
