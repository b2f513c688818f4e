//! Pictures of the documentation: a hand that an operator pushes, and a hand that presses on a table.
//!
//! `cargo run --release -p opspace --example readme_picture -- [FOLDER]` draws `compliant-x.svg` and `press-table.svg` in
//! `runs/readme_picture`, or in FOLDER; README and docs show the copies in `docs/`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

#[path = "common/curves.rs"]
mod curves;

#[path = "common/plot.rs"]
mod plot;

use curves::{curve, tick};
use opspace::experiment::{Experiment, Files, Progress};
use opspace::log::Recording;
use plot::{BLUE, GREEN, Line, ORANGE, Panel, draw};
use std::error::Error;

/// Joint whose torques are shown.
const JOINT: usize = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).unwrap_or("runs/readme_picture".to_owned());
    std::fs::create_dir_all(&folder)?;
    pushed_hand(&format!("{folder}/compliant-x.svg"))?;
    pressing_hand(&format!("{folder}/press-table.svg"))
}

/// Runs a task, with settings, and returns its log.
fn log_of(task: &str, settings: &[&str]) -> Result<Recording, Box<dyn Error>> {
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    let path = format!("tasks/{task}.toml");
    let experiment = Experiment::load(Files::Disk, path.as_ref(), None, Default::default(), &settings)?;
    let folder = format!("readme_picture/{task}");
    common::record(&folder, &experiment, |log| experiment.run(log, &Progress::default()))?;
    Ok(Recording::read(format!("runs/{folder}/run.mcap"))?)
}

/// Draws desired and motor torque of a joint, and motion of a hand that an operator pushes.
fn pushed_hand(path: &str) -> Result<(), Box<dyn Error>> {
    let (recording, shown_s) = (log_of("compliant-x", &[])?, 2.0..8.0);
    let tick = tick(&recording)?;
    let reference = tick.signal("hand.reference").ok_or("no reference")?;
    let held = reference.row(reference.len() - 1);
    let joint = &tick.signal("torque_desired").ok_or("no torque")?.elements()[JOINT];
    let torque = |signal| curve(tick, (&shown_s, 5), (signal, JOINT), (0.0, 1.0));
    let moved = |axis| curve(tick, (&shown_s, 5), ("hand.position", axis), (held[axis], 1e3));
    let torques = vec![
        Line::new("motor torque", ORANGE, 8, torque("motor_torque")?),
        Line::new("desired torque", BLUE, 4, torque("torque_desired")?),
    ];
    let motions = vec![
        Line::new("x: compliant", ORANGE, 6, moved(0)?),
        Line::new("y: held", BLUE, 4, moved(1)?),
        Line::new("z: held", GREEN, 4, moved(2)?),
    ];
    let title = format!("Torque of the {}", joint.replace('_', " "));
    let panels = [
        Panel::over_time(&title, "torque (Nm)", torques),
        Panel::over_time("Motion of the hand while an operator pushes it", "displacement (mm)", motions),
    ];
    draw(path, 1, &panels.map(|panel| Panel { x_range: Some(shown_s.clone()), ..panel }))
}

/// Draws force and target of a hand on a hard, nearly undamped table, and the energy of its force feedback.
fn pressing_hand(path: &str) -> Result<(), Box<dyn Error>> {
    let table =
        ["environment.board.wall.stiffness_n_per_m=50000.0", "environment.board.wall.damping_ns_per_m=5.0"];
    let (recording, shown_s) = (log_of("press-table", &table)?, 0.0..7.0);
    let z = |signal, scale| curve(tick(&recording)?, (&shown_s, 5), (signal, 2), (0.0, scale));
    let forces = vec![
        Line::new("sensed", ORANGE, 6, z("hand.sensed_force", 1.0)?),
        Line::new("target", BLUE, 4, z("hand.target_force", 1.0)?),
    ];
    let energies = vec![Line::new("energy", GREEN, 5, z("hand.force_energy", 1e3)?)];
    let panels = [
        Panel::over_time(
            "Force on a table of 50 kN/m: at rest, and from 4 s along a circle",
            "force (N)",
            forces,
        ),
        Panel::over_time("Energy that the force feedback gives to fast motion", "energy (mJ)", energies),
    ];
    draw(path, 1, &panels.map(|panel| Panel { x_range: Some(shown_s.clone()), ..panel }))
}
