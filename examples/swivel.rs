//! Swivel angle of an elbow, in the null space of a hand's pose.
//!
//! `cargo run --release -p opspace --example swivel` writes to `runs/swivel`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::experiment::{Experiment, Files, Progress};
use opspace::log::Recording;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = "tasks/panda-swivel.toml".as_ref();
    let experiment = Experiment::load(Files::Disk, task, None, Default::default(), &[])?;
    common::record("swivel", &experiment, |log| experiment.run(log, &Progress::default()))?;
    let recording = Recording::read("runs/swivel/run.mcap")?;
    let angle = recording.tick()?.signal("elbow.value").ok_or("the elbow's angle is logged")?;
    let values = angle.rows().map(|row| row[0]).filter(|value| value.is_finite());
    let (least, most) = values.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
    println!("range of the elbow's swivel angle: {:.2} rad", most - least);
    Ok(())
}
