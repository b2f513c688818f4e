//! Impedances and compliant axes of tasks whose controller, inverse kinematics, has neither.

use super::case::PreflightCase;
use super::diagnostic::Diagnostic;
use crate::codes::Code;
use crate::run::compliance::compliance;
use crate::run::experiment::ControllerKind;

/// Reports each task whose compliance the controller ignores, once.
pub(crate) fn ignored(case: &PreflightCase<'_>) -> Vec<Diagnostic> {
    let controller = case.experiment.options().controller;
    if controller == ControllerKind::Osc {
        return Vec::new();
    }
    let mut found: Vec<(&str, Diagnostic)> = Vec::new();
    for (number, stack) in case.task_sets.iter().enumerate() {
        for name in stack.priority {
            let Some(parameters) = stack.task.get(name) else { continue };
            if found.iter().any(|(known, _)| known == name) {
                continue;
            }
            let Some((what, key)) = compliance(parameters) else { continue };
            let message = format!(
                "task '{name}': {what} has no effect with controller '{}', which controls positions: the servos do not yield",
                controller.name()
            );
            let help = "run it with controller 'osc', the default, for axes that yield".to_owned();
            let key = case.key(number, name, &[parameters.kind(), key]);
            found.push((name, Diagnostic::new(Code::IgnoredCompliance, &key, message, help)));
        }
    }
    found.into_iter().map(|(_, diagnostic)| diagnostic).collect()
}
