//! A task that panics while the robot moves: the robot is stopped, log and report are complete up to the panic and
//! mention it, and the log can be replayed.
//!
//! `cargo run --release -p opspace --example panic_in_a_task` writes to `runs/panic_in_a_task`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use nalgebra::{Matrix6xX, Vector6};
use opspace::backend::{Backend, Sample};
use opspace::control::{ControlError, Coordinate, CoordinateGains, CoordinateTask, ScalarReference};
use opspace::experiment::{Experiment, Extensions, Files, Progress, TaskKind};
use opspace::log::{OutcomeRecord, Recording};
use opspace::model::{Data, Model};
use serde::Deserialize;

/// Angle of a joint, corrected by a table with one entry per tenth of a radian. Its bug: angles beyond the end of the
/// table are not handled.
struct CorrectedAngle {
    joint: usize,
    corrections_rad: [f64; 8],
}

impl Coordinate for CorrectedAngle {
    fn value(&self, _model: &Model, data: &Data) -> Vector6<f64> {
        let angle = data.q[self.joint];
        Vector6::x() * (angle + self.corrections_rad[(10.0 * angle.abs()) as usize])
    }

    fn jacobian(&self, _model: &Model, _data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        rows[(0, self.joint)] = 1.0;
    }

    fn bias(&self, _model: &Model, _data: &Data) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("angle", "rad")
    }
}

/// Parameters `[task.NAME.corrected-angle]` of a task file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CorrectedAngleParameters {
    joint: String,
    reference: ScalarReference,
    gains: CoordinateGains,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let kind = TaskKind::new("corrected-angle", |p: &CorrectedAngleParameters, name, model, _context| {
        let key = format!("task.{name}.corrected-angle.joint");
        let joint = model.joint(&p.joint).map_err(|unknown| ControlError::new(key, unknown))?;
        let coordinate = CorrectedAngle { joint, corrections_rad: [0.0; 8] };
        Ok(Box::new(CoordinateTask::new(name, coordinate, p.gains).with_references([p.reference.clone()])))
    });
    let extensions = Extensions::default().with(kind);
    let task = "examples/tasks/corrected_angle.toml".as_ref();
    let experiment = Experiment::load_with(&extensions, Files::Disk, task, None, Default::default(), &[])?;

    let mut arm = experiment.simulated_arm()?;
    common::record("panic_in_a_task", &experiment, |log| {
        experiment.run_on(&mut arm, log, &Progress::default())
    })?;
    // After the stop the robot comes to rest and is held.
    let mut sample = Sample::new(arm.capabilities());
    for _ in 0..300 {
        arm.read(&mut sample)?;
    }
    assert!(arm.true_dq().amax() < 1e-3, "joint velocities after the stop, rad/s: {:?}", arm.true_dq());

    let recording = Recording::read("runs/panic_in_a_task/run.mcap")?;
    let outcome = OutcomeRecord::of(&recording);
    let fault = outcome.fault.ok_or("the log says why the run ended")?;
    assert!(fault.contains("panicked"), "{fault}");
    let moved = recording.tick()?.signal("arm.velocity").ok_or("the task is in the log")?;
    let last = moved.rows().last().ok_or("the log has rows")?[0];
    println!(
        "the joint moved at {last:.2} rad/s in the last cycle of the log, and is at rest after the stop"
    );
    Ok(())
}
