//! A task of the user that panics while the robot moves: the log is closed, records the panic, and can be replayed.

use nalgebra::{Matrix6xX, Vector6};
use opspace_control::{Coordinate, CoordinateGains, CoordinateTask, ScalarReference};
use opspace_experiment::run::replay::replay;
use opspace_experiment::{
    Experiment, Extensions, FileError, Files, Progress, RobotDefinition, RunOptions, Source, TaskDefinition,
    TaskKind,
};
use opspace_log::{OutcomeRecord, Recording};
use opspace_loop::{Fault, RunOutcome};
use opspace_model::{Data, Model};
use serde::Deserialize;
use std::io::Cursor;
use std::path::Path;

/// Index of the joint of the task.
const JOINT: usize = 0;

/// Position below which the task panics, rad; the task starts at −0.45 rad and moves down.
const PANICS_BELOW_RAD: f64 = -0.6;

/// Position of a joint, which panics below [`PANICS_BELOW_RAD`].
struct Panicking;

impl Coordinate for Panicking {
    fn value(&self, _model: &Model, data: &Data) -> Vector6<f64> {
        assert!(data.q[JOINT] >= PANICS_BELOW_RAD, "a user's error");
        Vector6::x() * data.q[JOINT]
    }

    fn jacobian(&self, _model: &Model, _data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        rows[(0, JOINT)] = 1.0;
    }

    fn bias(&self, _model: &Model, _data: &Data) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("angle", "rad")
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PanickingParameters {
    reference: ScalarReference,
    gains: CoordinateGains,
}

const TASK: &str = r#"robot = "robots/asimo-arm"
duration_s = 2.0
start_rad = { shoulder_pitch = -0.45, shoulder_roll = -0.35, shoulder_yaw = 0.25, elbow = -1.35 }
priority = ["arm", "rest"]
[task.arm.panicking]
reference.point-to-point = { goal = { offset_rad = -0.4 }, duration_s = 1.0 }
gains = { frequency_rad_per_s = 20.0, damping_ratio = 1.0 }
[task.rest.joint-damping]
damping_nms_per_rad = 2.0
"#;

fn experiment() -> Experiment {
    let kind = TaskKind::new("panicking", |p: &PanickingParameters, name, _model, _context| {
        let task = CoordinateTask::new(name, Panicking, p.gains);
        Ok(Box::new(task.with_references([p.reference.clone()])))
    });
    let extensions = Extensions::default().with(kind);
    let task = TaskDefinition::from_sources_with(&extensions, Source::new("panicking.toml", TASK), |_| {
        Err(FileError::of_file("none", "no recording is named", None))
    });
    let robot =
        RobotDefinition::load(Files::Embedded, Path::new("robots/asimo-arm"), &[]).expect("a good robot");
    Experiment::new(robot, task.expect("a good task"), RunOptions::default(), Vec::new()).expect("they fit")
}

/// Compared: the logged positions and the position of the panic; the outcome in the log and that of the run; the rows
/// of the log and of its replay.
#[test]
fn log_ends_before_panic_and_replays() {
    let experiment = experiment();
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("it is recorded");
    let RunOutcome::Faulted { fault: Fault::Panicked, time_s } = result.outcome else {
        panic!("{:?}", result.outcome)
    };
    let log = Recording::from_bytes(result.sink.get_ref()).expect("a log");
    assert!(log.damage.is_none());
    let outcome = OutcomeRecord::of(&log);
    assert_eq!(outcome, result.record);
    assert!(outcome.fault.expect("a fault").contains("panicked"));

    let tick = log.tick().expect("rows");
    let positions = tick.signal("q").expect("positions");
    let last = positions.rows().map(|q| q[JOINT]).last().expect("rows");
    assert!(positions.rows().all(|q| q[JOINT] >= PANICS_BELOW_RAD));
    assert!(last < PANICS_BELOW_RAD + 1e-3, "the row before the panic: {last} rad");
    let period_s = experiment.profile().1.period_s();
    assert!((time_s - tick.time_s.last().expect("rows") - period_s).abs() < 1e-9, "the next cycle");

    let report = replay(&experiment, &log).expect("it can be replayed");
    assert_eq!((report.compared, report.differing), (tick.len(), 0), "{:?}", report.first_difference);
    let summary = experiment.summary(&log, &result.record, None);
    assert!(summary.faulted.expect("a fault").contains("panicked"));
}
