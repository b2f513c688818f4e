//! Reads a log: rows of a channel by name, the outcome, and the files from which the run was made.
//!
//! `cargo run --release -p opspace --example read_a_log -- [LOG]`; without LOG it records a run first.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::experiment::{Experiment, Files, Progress, RunOptions};
use opspace::log::{OutcomeRecord, Recording};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = match std::env::args().nth(1) {
        Some(path) => path,
        None => {
            let options = RunOptions { duration_s: Some(3.0), ..RunOptions::default() };
            let experiment =
                Experiment::load(Files::Disk, "tasks/compliant-x.toml".as_ref(), None, options, &[])?;
            common::record("read_a_log", &experiment, |log| experiment.run(log, &Progress::default()))?;
            "runs/read_a_log/run.mcap".to_owned()
        }
    };
    let recording = Recording::read(&path)?;
    for channel in &recording.channels {
        let signals = channel.layout.signals.iter().map(|signal| signal.name.as_str());
        println!(
            "{}: {} rows of {}",
            channel.layout.channel,
            channel.len(),
            signals.collect::<Vec<_>>().join(", ")
        );
    }
    let torque = recording.tick()?.signal("torque_desired").ok_or("this log has no signal torque_desired")?;
    let largest = torque.rows().flatten().filter(|t| t.is_finite()).fold(0.0, |max: f64, t| max.max(t.abs()));
    println!("largest desired torque: {largest:.2} Nm");
    println!("outcome: {:?}", OutcomeRecord::of(&recording));
    let files = recording.attachments.iter().map(|file| file.name.as_str());
    println!("files: {}", files.collect::<Vec<_>>().join(", "));
    Ok(())
}
