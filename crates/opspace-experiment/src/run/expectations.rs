//! Expectations of a task file: bounds on metrics of its run, so that a program can judge the run by its exit code.

use crate::files::robot::RobotDefinition;
use crate::files::source::FileError;
use crate::files::task::TaskDefinition;
use crate::metrics::metric::Metric;
use crate::metrics::metric_tables::{
    ElementError, Evaluation, JointMetrics, Metrics, TaskMetrics, error_names, range_name, response_names,
};
use crate::suggest::choices;
use crate::text::format_number;
use opspace_control::{AXIS_NAMES, CartesianReference, TaskParameters};

/// Checks that each expectation has a bound and names a metric: one of the run, or `TASK.metric` (of an axis too), `TASK.ELEMENT`
/// (its rms error) or `JOINT.metric`.
pub(crate) fn check(task: &TaskDefinition, robot: &RobotDefinition) -> Result<(), FileError> {
    for (name, expectation) in &task.file.expect {
        let refuse = |message: String, help: Option<String>| {
            Err(FileError::at_key(&task.source, ["expect", name], message, help))
        };
        if expectation.at_most.is_none() && expectation.at_least.is_none() {
            return refuse("no bound is given".to_owned(), Some("add `at_most` or `at_least`".to_owned()));
        }
        let Some((owner, metric)) = name.split_once('.') else {
            let metrics = keys(Metrics::rows().iter().chain(task.tables.added()));
            if !metrics.contains(name) {
                let is_of_an_axis = (0..AXIS_NAMES.len()).any(|axis| of_axis(axis).contains(name));
                let help = match is_of_an_axis {
                    true => format!("metrics of an axis are those of a task: write \"TASK.{name}\""),
                    false => choices(name, &metrics),
                };
                return refuse(format!("unknown metric `{name}`"), Some(help));
            }
            continue;
        };
        let is_joint = robot.model.joints().iter().any(|joint| joint.name == owner);
        let tasks = task.tasks_of_the_run();
        let is_task = tasks.iter().any(|(task, _)| *task == owner);
        // Joints and coordinates have elements, a Cartesian task and a centre of mass have axes.
        if !is_joint && let Some(controlled) = controlled_axes(task, owner) {
            let uncontrolled =
                |axis: &usize| !controlled[*axis] && of_motion(*axis).iter().any(|n| n == metric);
            let all: Vec<String> = keys(&TaskMetrics::rows())
                .into_iter()
                .chain((0..AXIS_NAMES.len()).flat_map(of_axis))
                .collect();
            if let Some(axis) = (0..AXIS_NAMES.len()).find(uncontrolled) {
                let axis = AXIS_NAMES[axis];
                let message =
                    format!("`{metric}` does not exist: {axis} is never a motion axis of task '{owner}'");
                let help = "only motion axes have errors and a stiffness; `x_range_m`, `y_range_m` and `z_range_m` exist for all axes";
                return refuse(message, Some(help.to_owned()));
            }
            if !all.iter().any(|key| key == metric) {
                let help = choices(metric, &all);
                return refuse(format!("unknown metric `{metric}` of a Cartesian task"), Some(help));
            }
        }
        let of_joints = keys(&JointMetrics::rows());
        if is_joint && !is_task && !of_joints.iter().any(|key| key == metric) {
            let help = choices(metric, &of_joints);
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

/// Axes of a Cartesian task or of a centre of mass that are motion axes at some time of the run, and all axes of a task whose
/// modes a program streams; `None` for other tasks.
fn controlled_axes(task: &TaskDefinition, name: &str) -> Option<[bool; 6]> {
    let sets = std::iter::once(&task.file.task).chain(task.events.iter().map(|event| &event.task));
    let axes = sets.filter_map(|tasks| match tasks.get(name)? {
        TaskParameters::Cartesian(task) if matches!(task.reference, CartesianReference::Streamed(_)) => {
            Some([true; 6])
        }
        TaskParameters::Cartesian(task) => Some(task.motion_axes()),
        TaskParameters::CenterOfMass(task) => Some(task.as_cartesian().motion_axes()),
        _ => None,
    });
    axes.reduce(|one, other| std::array::from_fn(|axis| one[axis] || other[axis]))
}

/// Names of the metrics that only a motion axis has: its errors, its stiffness and its hysteresis.
fn of_motion(axis: usize) -> Vec<String> {
    let [_, _, stiffness, hysteresis, _, desired] = response_names(axis);
    error_names(axis).into_iter().chain([stiffness, hysteresis, desired]).collect()
}

/// Names of the metrics of an axis.
fn of_axis(axis: usize) -> Vec<String> {
    let of_translation = (axis < 3).then(|| response_names(axis).into_iter().chain([range_name(axis)]));
    error_names(axis).into_iter().chain(of_translation.into_iter().flatten()).collect()
}

/// Keys of metrics.
fn keys<'a>(metrics: impl IntoIterator<Item = &'a Metric>) -> Vec<String> {
    metrics.into_iter().map(|metric| metric.key.to_owned()).collect()
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
    let Some((owner, metric)) = name.split_once('.') else { return evaluation.metrics.get(name) };
    if let Some(task) = evaluation.tasks.get(owner) {
        let of_axis = || task.axes.get(metric).copied();
        return task.value(metric).or_else(of_axis).or_else(|| element(&task.elements, metric));
    }
    evaluation.joints.get(owner)?.value(metric)
}

/// Rms error of an element of a task.
fn element(elements: &[ElementError], name: &str) -> Option<f64> {
    elements.iter().find(|element| element.name == name).map(|element| element.rms)
}
