//! Registered task kinds in files, and the errors of mistakes in them.

use nalgebra::{Matrix6xX, Vector6};
use opspace_control::{Coordinate, CoordinateGains, CoordinateTask, TaskParameters};
use opspace_experiment::{
    Experiment, Extensions, FileError, Files, RobotDefinition, RunOptions, Source, TaskDefinition, TaskKind,
};
use opspace_model::{Data, Model};
use opspace_preflight::diagnostics;
use opspace_preflight::not_checked;
use serde::Deserialize;
use std::path::Path;

/// Coordinate that is the sum of all joint positions.
struct JointSum;

impl Coordinate for JointSum {
    fn rows(&self) -> usize {
        1
    }

    fn value(&self, _model: &Model, data: &Data) -> Vector6<f64> {
        Vector6::x() * data.q.sum()
    }

    fn jacobian(&self, _model: &Model, _data: &Data, rows: &mut Matrix6xX<f64>) {
        rows.fill(0.0);
        rows.row_mut(0).fill(1.0);
    }

    fn bias(&self, _model: &Model, _data: &Data) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn element(&self, _row: usize) -> (&'static str, &'static str) {
        ("sum", "rad")
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct JointSumParameters {
    gains: CoordinateGains,
}

fn extensions() -> Extensions {
    Extensions::default().with(TaskKind::new(
        "joint-sum",
        |p: &JointSumParameters, name, _model, _context| {
            Ok(Box::new(CoordinateTask::new(name, JointSum, p.gains)))
        },
    ))
}

const TASK: &str = r#"robot = "../../../robots/panda"
duration_s = 1.0
start_rad = { joint2 = -0.6, joint3 = 0.3, joint4 = -1.9, joint6 = 1.8 }
priority = ["sum", "rest"]
[task.sum.joint-sum]
gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }
[task.rest.joint-damping]
damping_nms_per_rad = 2.0
"#;

fn load(text: &str) -> Result<TaskDefinition, FileError> {
    TaskDefinition::from_sources_with(&extensions(), Source::new("sum.toml", text), |_| {
        Err(FileError::of_file("none", "no recording is named", None))
    })
}

fn panda() -> RobotDefinition {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots/panda");
    RobotDefinition::load(Files::Disk, &path, &[]).expect("a robot")
}

/// Compared: the signals of the controller, and the task in the file that has a registered kind.
#[test]
fn registered_kind_is_built_from_its_table() {
    let task = load(TASK).expect("a good file");
    assert!(matches!(&task.file.task["sum"], TaskParameters::Registered(p) if p.kind() == "joint-sum"));
    let experiment =
        Experiment::new(panda(), task, RunOptions::default(), Vec::new()).expect("it fits the robot");
    let controller = experiment.controller().expect("it was checked");
    assert!(controller.signals().iter().any(|signal| signal.name == "sum.value"));
}

/// Compared: files with one mistake each, and line, message and help of the error.
#[test]
fn registered_kind_errors_name_their_line() {
    let table = TASK.replace("damping_ratio = 1.0", "damping_ration = 1.0");
    let error = load(&table).expect_err("an unknown key");
    assert_eq!((error.line(), error.message()), (Some(6), "unknown key `damping_ration`"));
    assert!(error.help().is_some_and(|help| help.contains("damping_ratio")), "{error:?}");

    let value = TASK.replace("frequency_rad_per_s = 10.0", "frequency_rad_per_s = \"fast\"");
    let error = load(&value).expect_err("a text for a number");
    assert_eq!(error.line(), Some(6), "{error:?}");

    let kind = TASK.replace("joint-sum", "joint-som");
    let error = load(&kind).expect_err("an unknown kind");
    assert_eq!(error.message(), "unknown task kind `joint-som`");
    let help = error.help().expect("a help");
    assert!(help.contains("joint-sum") && help.contains("cartesian"), "{help}");
    assert_eq!(error.line(), Some(5));

    let event = format!(
        "{TASK}[[event]]\ntime_s = 0.5\nset = [\"task.sum.joint-sum.gains.frequency_rad_per_s=-1\"]\n"
    );
    let error = load(&event).expect_err("a frequency below zero");
    assert!(error.message().contains("above 0"), "{error:?}");
}

/// A kind whose name is already in use is refused.
#[test]
fn taken_kind_name_is_refused() {
    let build = |p: &JointSumParameters, name: &str, _: &Model, _: &opspace_control::ControlContext| {
        Ok(Box::new(CoordinateTask::new(name, JointSum, p.gains)) as Box<dyn opspace_control::Task>)
    };
    for kind in ["joint-sum", "cartesian"] {
        let error = extensions().add(TaskKind::new(kind, build)).expect_err("it is taken");
        assert_eq!(error.to_string(), format!("the task kind '{kind}' already exists"));
    }
}

/// Returns a file with a swivel task whose angle changes by 0.3 rad within `duration_s`.
fn swivel(duration_s: &str) -> String {
    let swivel = format!(
        r#"[task.sum.swivel]
shoulder = "link2"
elbow = "link4"
wrist = "link6"
reference.point-to-point = {{ goal = {{ offset_rad = 0.3 }}, duration_s = {duration_s} }}
gains = {{ frequency_rad_per_s = 10.0, damping_ratio = 1.0 }}
"#
    );
    let begin = TASK.find("[task.sum").expect("the table");
    let end = TASK.find("[task.rest").expect("the table");
    format!("{}{swivel}{}", &TASK[..begin], &TASK[end..])
}

/// Compared: a swivel task in a file, and its signal.
#[test]
fn swivel_task_is_read_from_file() {
    let text = swivel("0.5");
    let experiment = |text: &str| {
        load(text).and_then(|task| Experiment::new(panda(), task, RunOptions::default(), Vec::new()))
    };
    let controller = experiment(&text).and_then(|experiment| experiment.controller()).expect("it fits");
    assert!(controller.signals().iter().any(|signal| signal.name == "sum.reference"));
    let error = experiment(&text.replace("link4", "elbow")).expect_err("no such frame");
    assert_eq!(error.line(), Some(7), "{error:?}");
}

/// Diagnostics of a swivel task whose reference is too fast for the joints, and of one with enough time; the key is
/// that of the task's reference.
#[test]
fn preflight_checks_every_task() {
    let experiment = |duration_s: &str| {
        let text = swivel(duration_s);
        let task = load(&text).expect("a good file");
        Experiment::new(panda(), task, RunOptions::default(), Vec::new()).expect("it fits the robot")
    };
    let key = "task.sum.swivel.reference";
    let found = |duration_s: &str| {
        let found = diagnostics(&experiment(duration_s));
        found.into_iter().filter(|found| found.key() == key).map(|found| found.message).collect::<Vec<_>>()
    };
    assert!(!found("0.05").is_empty(), "a reference faster than the joints");
    assert_eq!(found("0.8"), Vec::<String>::new(), "a slow one");
    assert!(not_checked(&experiment("0.8")).is_empty(), "its gains are known");
}

/// Compared: a task with an impedance, whose gains depend on the inertia of the arm, and the list of unchecked tasks.
#[test]
fn unchecked_gains_are_reported() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-impedance.toml");
    let experiment = Experiment::load(Files::Disk, &path, None, RunOptions::default(), &[]).expect("a task");
    assert!(!not_checked(&experiment).is_empty());
}
