//! Program with the command line of opspace and an entry of its own in each table: a kind of tasks, a metric with a column, a
//! check, a kind of figures, and a command.
//!
//! `cargo run -p opspace-cli --example own_entries -- run examples/tasks/bent_elbow.toml`

#![expect(clippy::print_stdout, reason = "a command prints")]

use nalgebra::{Matrix6xX, Vector6};
use opspace_cli::{Command, Extensions, clap, main_with};
use opspace_control::{Coordinate, CoordinateGains, CoordinateTask, ScalarReference};
use opspace_experiment::{Better, Code, Column, Finding, LogMetric, Metric, Place, TaskKind};
use opspace_log::Recording;
use opspace_model::{Data, Model};
use opspace_preflight::Check;
use opspace_report::FigureKind;
use opspace_report::figure::{Figure, Panel, Series};
use serde::Deserialize;
use std::ops::Range;
use std::process::ExitCode;

/// Difference of two neighbouring joints, rad.
struct JointDifference {
    first: usize,
}

impl Coordinate for JointDifference {
    fn value(&self, _model: &Model, data: &Data) -> Vector6<f64> {
        Vector6::x() * (data.q[self.first + 1] - data.q[self.first])
    }

    fn jacobian(&self, _model: &Model, _data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        rows[(0, self.first)] = -1.0;
        rows[(0, self.first + 1)] = 1.0;
    }

    fn bias(&self, _model: &Model, _data: &Data) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("difference", "rad")
    }
}

/// Parameters `[task.NAME.joint-difference]` of a task file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DifferenceParameters {
    first: usize,
    reference: ScalarReference,
    gains: CoordinateGains,
}

fn joint_difference() -> TaskKind {
    TaskKind::new("joint-difference", |p: &DifferenceParameters, name, _model, _context| {
        let task = CoordinateTask::new(name, JointDifference { first: p.first }, p.gains);
        Ok(Box::new(task.with_references([p.reference.clone()])))
    })
}

/// Positions of the first joint, with their times.
fn first_joint(segment: &Recording) -> (Vec<f64>, Vec<f64>) {
    let Some(tick) = segment.channel("tick") else { return Default::default() };
    let Some(q) = tick.signal("q") else { return Default::default() };
    (tick.time_s.clone(), (0..tick.len()).map(|k| q.row(k)[0]).collect())
}

/// Range of the first joint while segments of the log arrive.
#[derive(Default)]
struct RangeOfMotion(Option<(f64, f64)>);

impl LogMetric for RangeOfMotion {
    fn add(&mut self, segment: &Recording, settled: Range<usize>) {
        for q in &first_joint(segment).1[settled] {
            let (low, high) = self.0.unwrap_or((*q, *q));
            self.0 = Some((low.min(*q), high.max(*q)));
        }
    }

    fn finish(self: Box<Self>) -> Option<f64> {
        self.0.map(|(low, high)| high - low)
    }
}

fn range_of_motion() -> Metric {
    let meaning = "Highest minus lowest position of the first joint, rad.";
    let metric =
        Metric::new("first_joint_range_rad", Better::Neither, meaning, || Box::new(RangeOfMotion::default()));
    metric.with_column(Column::new("first-joint-range", "range of the first joint", "mrad", 1e3).by_default())
}

fn short_runs() -> Check {
    Check::new("short-runs", "runs of less than 3 s", |experiment| {
        if experiment.duration_s() >= 3.0 {
            return Vec::new();
        }
        let message = "the run is too short to be judged".to_owned();
        vec![Finding::of(Code::Added("short-run"), Place::TaskFile("duration_s".to_owned()), message)]
    })
}

fn first_joint_figure() -> FigureKind {
    FigureKind::new("first-joint", |_experiment, segment| {
        let (x, y) = first_joint(segment);
        let series = Series { label: "measured".to_owned(), x, y, ..Series::default() };
        let panel = Panel {
            x_label: "time (s)".to_owned(),
            y_label: "position (rad)".to_owned(),
            series: vec![series],
            ..Panel::default()
        };
        vec![Figure { title: "First joint".to_owned(), panels: vec![panel], ..Figure::default() }]
    })
}

fn hello() -> Command {
    let arguments = clap::Command::new("hello").about("Greet, and list the kinds of tasks");
    Command::new("hello", arguments, |_matches, extensions| {
        let kinds: Vec<&str> = extensions.names::<TaskKind>().collect();
        println!("Hello. Kinds of tasks: {}.", kinds.join(", "));
        ExitCode::SUCCESS
    })
}

fn main() -> ExitCode {
    let extensions = Extensions::default()
        .with(joint_difference())
        .with(range_of_motion())
        .with(short_runs())
        .with(first_joint_figure())
        .with(hello());
    main_with(extensions)
}
