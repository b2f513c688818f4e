//! User-defined task: the distance of a frame to a point, as a kind of task in task files.
//!
//! `cargo run --release -p opspace --example own_task` writes to `runs/own_task`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use nalgebra::{Matrix6xX, Vector3, Vector6};
use opspace::control::{ControlError, Coordinate, CoordinateGains, CoordinateTask, ScalarReference};
use opspace::experiment::{Experiment, Extensions, Files, Progress, TaskKind};
use opspace::model::{
    Data, FrameId, Model, frame_bias_acceleration, frame_jacobian, frame_placement, frame_velocity,
};
use serde::Deserialize;

/// Distance d = |x − p| of a frame's origin x to a point p, m. With n = (x − p)/d, and v and a the velocity and
/// acceleration of x: ḋ = n · v, d̈ = n · a + |v − (n · v) n|²/d.
struct Distance {
    frame: FrameId,
    point: Vector3<f64>,
}

impl Distance {
    /// Direction n and distance d.
    fn direction_and_length(&self, model: &Model, data: &Data) -> (Vector3<f64>, f64) {
        let away = frame_placement(model, data, self.frame).translation - self.point;
        (away.normalize(), away.norm())
    }
}

impl Coordinate for Distance {
    fn value(&self, model: &Model, data: &Data) -> Vector6<f64> {
        Vector6::x() * self.direction_and_length(model, data).1
    }

    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        let (n, _) = self.direction_and_length(model, data);
        // The first three rows of the frame's Jacobian are linear: n · J_v is the row ∂d/∂q.
        frame_jacobian(model, data, self.frame, rows);
        for mut column in rows.column_iter_mut() {
            let by_joint = n.dot(&column.fixed_rows::<3>(0));
            column.copy_from(&(Vector6::x() * by_joint));
        }
    }

    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        let (n, d) = self.direction_and_length(model, data);
        let v = frame_velocity(model, data, self.frame).linear;
        let a = frame_bias_acceleration(model, data, self.frame).linear;
        Vector6::x() * (n.dot(&a) + (v - n * n.dot(&v)).norm_squared() / d)
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("distance", "m")
    }
}

/// Parameters `[task.NAME.distance]` of a task file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DistanceParameters {
    frame: String,
    point_m: [f64; 3],
    reference: ScalarReference,
    gains: CoordinateGains,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let kind = TaskKind::new("distance", |p: &DistanceParameters, name, model, _context| {
        let key = format!("task.{name}.distance.frame");
        let frame = model.frame_id(&p.frame).map_err(|unknown| ControlError::new(key, unknown))?;
        let coordinate = Distance { frame, point: p.point_m.into() };
        Ok(Box::new(CoordinateTask::new(name, coordinate, p.gains).with_references([p.reference.clone()])))
    });
    let extensions = Extensions::default().with(kind);
    let task = "examples/tasks/distance.toml".as_ref();
    let experiment = Experiment::load_with(&extensions, Files::Disk, task, None, Default::default(), &[])?;
    common::record("own_task", &experiment, |log| experiment.run(log, &Progress::default()))
}
