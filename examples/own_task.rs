//! A task of one's own: the distance of a frame to a point, as a kind in task files.
//!
//! `cargo run --release -p opspace --example own_task` writes to `runs/own_task`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use nalgebra::{Matrix6xX, Vector3, Vector6};
use opspace::control::{ControlError, Coordinate, CoordinateGains, CoordinateTask, ScalarReference};
use opspace::experiment::{Experiment, Extensions, Files, Progress, TaskKinds};
use opspace::model::{
    Data, FrameId, Model, frame_bias_acceleration, frame_jacobian, frame_placement, frame_velocity,
};
use serde::Deserialize;

/// d = |x − p| of a frame's origin x to a point p, m. With n = (x − p)/d: ḋ = n · v, d̈ = n · a + |v − (n · v) n|²/d.
struct Distance {
    frame: FrameId,
    point: Vector3<f64>,
}

impl Coordinate for Distance {
    fn rows(&self) -> usize {
        1
    }

    fn value(&self, model: &Model, data: &Data) -> Vector6<f64> {
        Vector6::x() * self.away_from_point(model, data).norm()
    }

    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        let direction = self.away_from_point(model, data).normalize();
        frame_jacobian(model, data, self.frame, rows);
        for mut column in rows.column_iter_mut() {
            let along = direction.dot(&column.fixed_rows::<3>(0));
            column.fill(0.0);
            column[0] = along;
        }
    }

    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        let (away, v) = (self.away_from_point(model, data), frame_velocity(model, data, self.frame).linear);
        let (direction, a) = (away.normalize(), frame_bias_acceleration(model, data, self.frame).linear);
        let across = v - direction * direction.dot(&v);
        Vector6::x() * (direction.dot(&a) + across.norm_squared() / away.norm())
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("distance", "m")
    }
}

impl Distance {
    fn away_from_point(&self, model: &Model, data: &Data) -> Vector3<f64> {
        frame_placement(model, data, self.frame).translation - self.point
    }
}

/// `[task.NAME.distance]` in a file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DistanceParameters {
    frame: String,
    point_m: [f64; 3],
    reference: ScalarReference,
    gains: CoordinateGains,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut tasks = TaskKinds::new();
    tasks.register("distance", |p: &DistanceParameters, name, model, _context| {
        let key = format!("task.{name}.distance.frame");
        let frame = model.frame(&p.frame).map_err(|unknown| ControlError::new(key, unknown))?;
        let coordinate = Distance { frame, point: p.point_m.into() };
        Ok(Box::new(CoordinateTask::new(name, coordinate, p.gains).with_references([p.reference.clone()])))
    })?;
    let extensions = Extensions::default().with_tasks(tasks);
    let task = "examples/tasks/distance.toml".as_ref();
    let experiment = Experiment::load_with(&extensions, Files::Disk, task, None, Default::default(), &[])?;
    common::record("own_task", &experiment, |log| experiment.run(log, &Progress::default()))
}
