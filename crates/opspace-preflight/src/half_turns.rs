//! Continuous joints that are half a turn away from an absolute goal, so that both ways are as long.

use super::case::PreflightCase;
use opspace_control::references::joint_reference::JointGoal;
use opspace_control::{BuildTask, JointReference, TaskParameters, TaskReference};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_model::JointKind;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Distance from half a turn up to which the measured start decides on the way, rad.
const NEAR_RAD: f64 = 0.01;

/// Diagnostics of the goals and rest postures of the first task set.
pub(crate) fn of_goals(case: &PreflightCase<'_>) -> Vec<Finding> {
    let Some(first) = case.task_sets.first() else { return Vec::new() };
    first.priority.iter().filter_map(|name| of_task(case, name, first.task.get(name)?)).collect()
}

/// Absolute positions of a goal.
fn positions(goal: &JointGoal) -> Option<&BTreeMap<String, f64>> {
    match goal {
        JointGoal::Absolute(positions) => Some(positions),
        JointGoal::Offset(_) => None,
    }
}

fn of_task(case: &PreflightCase<'_>, name: &str, task: &TaskParameters) -> Option<Finding> {
    // Positions one after the other; `None` for offsets, after which the way is not followed.
    let goals: Vec<Option<&BTreeMap<String, f64>>> = match (task, task.reference()) {
        (TaskParameters::JointPosture(posture), _) => vec![Some(&posture.posture_rad)],
        (_, Some(TaskReference::Joint(JointReference::PointToPoint(p)))) => vec![positions(&p.goal)],
        (_, Some(TaskReference::Joint(JointReference::Goal(p)))) => vec![positions(&p.posture)],
        (_, Some(TaskReference::Joint(JointReference::Waypoints(list)))) => {
            list.iter().map(|waypoint| positions(&waypoint.goal)).collect()
        }
        _ => return None,
    };
    let mut at = case.start.clone();
    for goal in goals.into_iter().map_while(|goal| goal) {
        for (joint, &goal) in goal {
            let Ok(index) = case.model.joint(joint) else { continue };
            let kind = case.model.joints()[index].kind;
            let to = kind.nearest_turn(goal, at[index]);
            if kind == JointKind::Continuous && ((to - at[index]).abs() - PI).abs() < NEAR_RAD {
                let message = format!(
                    "task '{name}': joint '{joint}' is half a turn away from its goal {goal}, so that the measured start decides which way \
                     it turns"
                );
                let help = "give the way by `offset_rad`, or by a waypoint between".to_owned();
                let key = ["task", name, task.kind()];
                return Some(Finding::new(Code::HalfTurn, &key, message, help));
            }
            at[index] = to;
        }
    }
    None
}
