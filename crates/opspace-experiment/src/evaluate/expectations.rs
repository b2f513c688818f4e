//! Expectations of a task file: bounds on metrics of its run, so that a program can judge the run by its exit code.

use crate::evaluate::metric_tables::{ElementError, Evaluation, JointMetrics, Metrics, TaskMetrics};
use crate::evaluate::table::format_number;
use crate::files::robot::RobotDefinition;
use crate::files::source::FileError;
use crate::files::suggest::choices;
use crate::files::task::TaskDefinition;
use opspace_control::TaskParameters;
use serde::Serialize;
use serde_json::Value;

/// Checks that each expectation has a bound and names a metric: one of the run, or `TASK.metric`, `TASK.ELEMENT` (its
/// rms error) or `JOINT.metric`.
pub(crate) fn check(task: &TaskDefinition, robot: &RobotDefinition) -> Result<(), FileError> {
    for (name, expectation) in &task.file.expect {
        let refuse = |message: String, help: Option<String>| {
            Err(FileError::at_key(&task.source, ["expect", name], message, help))
        };
        if expectation.at_most.is_none() && expectation.at_least.is_none() {
            return refuse("no bound is given".to_owned(), Some("add `at_most` or `at_least`".to_owned()));
        }
        let Some((owner, metric)) = name.split_once('.') else {
            if !keys(&Metrics::default()).contains(name) {
                let help = choices(name, &keys(&Metrics::default()));
                return refuse(format!("unknown metric `{name}`"), Some(help));
            }
            continue;
        };
        let is_joint = robot.model.joints().iter().any(|joint| joint.name == owner);
        let tasks = task.tasks_of_the_run();
        let is_task = tasks.iter().any(|(task, _)| *task == owner);
        let is_cartesian = |(task, parameters): &(&str, &TaskParameters)| {
            *task == owner && matches!(parameters, TaskParameters::Cartesian(_))
        };
        // Joints and coordinates have elements; the axes of a Cartesian task have no metrics of their own.
        if !is_joint && tasks.iter().any(is_cartesian) && !of_tasks().iter().any(|key| key == metric) {
            let help = choices(metric, &of_tasks());
            return refuse(format!("unknown metric `{metric}` of a Cartesian task"), Some(help));
        }
        if is_joint && !is_task && !keys(&JointMetrics::default()).iter().any(|key| key == metric) {
            let help = choices(metric, &keys(&JointMetrics::default()));
            return refuse(format!("unknown metric `{metric}` of a joint"), Some(help));
        }
        if !is_joint && !is_task {
            let tasks = tasks.iter().map(|(task, _)| *task);
            let joints = robot.model.joints().iter().map(|joint| joint.name.as_str());
            let help = choices(owner, tasks.chain(joints).collect::<Vec<_>>());
            return refuse(format!("no task and no joint has the name `{owner}`"), Some(help));
        }
    }
    Ok(())
}

/// Names of the metrics of a task.
fn of_tasks() -> Vec<String> {
    let mut names = keys(&TaskMetrics::default());
    names.retain(|name| name != "kind" && name != "elements");
    names
}

/// Names of the fields of a table of metrics.
fn keys(metrics: &impl Serialize) -> Vec<String> {
    match serde_json::to_value(metrics) {
        Ok(Value::Object(map)) => map.keys().cloned().collect(),
        _ => Vec::new(),
    }
}

/// Describes each expectation of a task that a run missed.
pub(crate) fn missed(task: &TaskDefinition, evaluation: &Evaluation) -> Vec<String> {
    let mut missed = Vec::new();
    for (name, expectation) in &task.file.expect {
        let value = value_of(evaluation, name);
        missed.extend(expectation.missed_by(value).map(|bound| match value {
            Some(value) => format!("{name} is {}, expected {bound}", format_number(value)),
            None => format!("{name} does not exist in this run, expected {bound}"),
        }));
    }
    missed
}

/// Value of a metric by its name in an expectation; `None` if the run does not have it.
fn value_of(evaluation: &Evaluation, name: &str) -> Option<f64> {
    let Some((owner, metric)) = name.split_once('.') else { return field(&evaluation.metrics, name) };
    if let Some(task) = evaluation.tasks.get(owner) {
        return field::<TaskMetrics>(task, metric).or_else(|| element(&task.elements, metric));
    }
    field(evaluation.joints.get(owner)?, metric)
}

/// Rms error of an element of a task.
fn element(elements: &[ElementError], name: &str) -> Option<f64> {
    elements.iter().find(|element| element.name == name).map(|element| element.rms)
}

fn field<T: Serialize>(metrics: &T, name: &str) -> Option<f64> {
    serde_json::to_value(metrics).ok()?.get(name)?.as_f64()
}
