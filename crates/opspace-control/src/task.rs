//! Tasks, their order, and the robot they are for.

use crate::axes::AXIS_NAMES;
use crate::cartesian::{CartesianParameters, CartesianTask};
use crate::error::{ControlError, Reason};
use crate::joint::{
    JointDampingParameters, JointPostureParameters, JointTask, JointTrackingParameters, Posture, Tracking,
    damping,
};
use crate::rank::{orientation_is_coupled, sampled_rank};
use crate::task_axes::TaskAxes;
use opspace_model::{FrameId, Model};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// One task of a file: `[task.NAME.KIND]`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TaskParameters {
    /// A frame that follows a reference on some axes and gives way on others.
    Cartesian(Box<CartesianParameters>),
    /// The joints follow a reference.
    JointTracking(JointTrackingParameters),
    /// The joints are drawn to a posture.
    JointPosture(JointPostureParameters),
    /// The joints are braked in proportion to their speed.
    JointDamping(JointDampingParameters),
}

/// Which of the arm's own forces the controller takes away before its tasks see the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Compensation {
    /// Gravity, Coriolis and centrifugal forces: C q̇ + g.
    #[default]
    Bias,
    /// Gravity alone.
    Gravity,
}

/// The tasks of a file and their order.
#[derive(Clone, Copy, Debug)]
pub struct Stack<'a> {
    /// Names of the tasks, the most important first. A task never disturbs one above it.
    pub priority: &'a [String],
    /// The tasks by name.
    pub task: &'a BTreeMap<String, TaskParameters>,
    /// Which of the arm's own forces are taken away.
    pub compensation: Compensation,
}

/// What a controller must know of the robot besides its model.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotFacts {
    /// Time from one update to the next, s.
    pub period_s: f64,
    /// The force sensors in the order of [`Measurement::wrenches`](crate::Measurement): name and frame.
    pub sensors: Vec<(String, FrameId)>,
    /// Whether the robot adds gravity's torque to those it is commanded.
    pub gravity_by_robot: bool,
}

/// The tasks of one robot: Cartesian ones in the order of their priority, and one in joint space below
/// them.
#[derive(Clone, Debug)]
pub(crate) struct Levels {
    pub cartesian: Vec<CartesianTask>,
    pub joint: Option<JointTask>,
}

impl Levels {
    pub(crate) fn new(model: &Model, stack: &Stack<'_>, robot: &RobotFacts) -> Result<Self, ControlError> {
        check_names(stack)?;
        let mut levels = Self { cartesian: Vec::new(), joint: None };
        for (place, name) in stack.priority.iter().enumerate() {
            let joint = match &stack.task[name] {
                TaskParameters::Cartesian(p) => {
                    levels.cartesian.push(CartesianTask::new(name, p, model, robot)?);
                    check_rank(model, &levels.cartesian)?;
                    continue;
                }
                TaskParameters::JointTracking(p) => JointTask::Tracking(Tracking::new(name, p, model)?),
                TaskParameters::JointPosture(p) => JointTask::Posture(Posture::new(name, p, model)?),
                TaskParameters::JointDamping(p) => JointTask::Damping(damping(name, p, model)?),
            };
            if let Some(below) = stack.priority.get(place + 1) {
                let reason = Reason::NotLast { name: name.clone(), below: below.clone() };
                return Err(ControlError::new("priority", reason));
            }
            levels.joint = Some(joint);
        }
        Ok(levels)
    }
}

/// `priority` and the tasks must name each other, one to one.
fn check_names(stack: &Stack<'_>) -> Result<(), ControlError> {
    let in_priority = |reason| Err(ControlError::new("priority", reason));
    for (place, name) in stack.priority.iter().enumerate() {
        if !stack.task.contains_key(name) {
            let known = stack.task.keys().cloned().collect();
            return in_priority(Reason::UnknownTask { name: name.clone(), known });
        }
        if stack.priority[..place].contains(name) {
            return in_priority(Reason::Repeated { name: name.clone() });
        }
    }
    for name in stack.task.keys() {
        let key = format!("task.{name}");
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if name.is_empty() || !name.chars().all(plain) {
            return Err(ControlError::new(key, Reason::Name { name: name.clone() }));
        }
        if !stack.priority.contains(name) {
            return Err(ControlError::new(key, Reason::Unranked { name: name.clone() }));
        }
    }
    Ok(())
}

/// The last of `tasks` must be able to move all its axes besides those of the tasks above it.
fn check_rank(model: &Model, tasks: &[CartesianTask]) -> Result<(), ControlError> {
    let all: Vec<&TaskAxes> = tasks.iter().map(|t| &t.axes).collect();
    let Some((last, above)) = all.split_last() else {
        return Ok(());
    };
    let name = tasks[above.len()].name.clone();
    let key = format!("task.{name}.cartesian.axes");
    let (axes, above, joints) = (last.rows(), above.iter().map(|t| t.rows()).sum::<usize>(), model.n());
    if above + axes > joints {
        return Err(ControlError::new(key, Reason::TooManyAxes { name, axes, above, joints }));
    }
    if let Some(&turn) = last.axes().iter().find(|&&axis| axis >= 3)
        && orientation_is_coupled(model, last.frame)
    {
        let key = format!("{key}.{}", AXIS_NAMES[turn]);
        return Err(ControlError::new(
            key,
            Reason::CoupledOrientation { name, axis: AXIS_NAMES[turn], joints },
        ));
    }
    let rank = sampled_rank(model, &all);
    if rank < above + axes {
        return Err(ControlError::new(key, Reason::RankDeficient { name, axes, above, rank }));
    }
    Ok(())
}
