//! Impedances and compliant axes of tasks whose controller, inverse kinematics, has neither, or whose transformer damps them.

use super::case::PreflightCase;
use opspace_experiment::codes::Code;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::compliance::compliance;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::servo_damping::{SERVO_DAMPING_NOTED, help_of_servo_damping};
use opspace_transformer::TransformerName;

/// Reports each task whose compliance the controller ignores, or the transformer damps, once.
pub(crate) fn ignored(case: &PreflightCase<'_>) -> Vec<Finding> {
    let controller = case.experiment.options().controller;
    let damping = damping(case.experiment);
    if controller == ControllerKind::Osc && damping.is_none() {
        return Vec::new();
    }
    let mut found: Vec<(&str, Finding)> = Vec::new();
    for (number, stack) in case.task_sets.iter().enumerate() {
        for name in stack.priority {
            let Some(parameters) = stack.task.get(name) else { continue };
            if found.iter().any(|(known, _)| known == name) {
                continue;
            }
            let Some((what, key)) = compliance(parameters) else { continue };
            let key = case.key(number, name, &[parameters.kind(), key]);
            if let Some((reason, help)) = &damping {
                let message = format!(
                    "task '{name}': {what} is damped by the servos: {reason}; the hand yields more slowly than that of a torque robot"
                );
                found.push((name, Finding::new(Code::DampedCompliance, &key, message, help.clone())));
                continue;
            }
            let message = format!(
                "task '{name}': {what} has no effect with controller '{}', which controls positions: the servos do not yield",
                controller.name()
            );
            let help = "run it with controller 'osc', the default, for axes that yield".to_owned();
            found.push((name, Finding::new(Code::IgnoredCompliance, &key, message, help)));
        }
    }
    found.into_iter().map(|(_, diagnostic)| diagnostic).collect()
}

/// Reason for which the transformer leaves a part of the servos' damping, and the remedy; `None` if it leaves none, or less than a
/// hand feels.
fn damping(experiment: &Experiment) -> Option<(String, String)> {
    if let Some(left) = experiment.servo_damping().ok()? {
        let help = format!("compare with --backend torque; {}", help_of_servo_damping(&left));
        return (left.share >= SERVO_DAMPING_NOTED).then(|| (left.to_string(), help));
    }
    let name = experiment.transformer_name()?;
    let is_default =
        experiment.options().transformer.is_none() && experiment.profile().1.transformer.is_none();
    if name != TransformerName::PAPER || !is_default {
        return None;
    }
    let reason = format!("transformer 'paper' is the default because {}", experiment.transformer_reason()?);
    let help = "compare with --backend torque; measure the delay of setpoints: with it, other transformers are the default";
    Some((reason, help.to_owned()))
}
