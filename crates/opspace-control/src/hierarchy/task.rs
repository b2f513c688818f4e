//! Tasks, their order, and the robot they are for.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::error::{ControlError, Reason};
use crate::hierarchy::level::{Level, RowTask};
use crate::hierarchy::nullspace::Nullspace;
use crate::hierarchy::rank::{Rows, orientation_is_coupled, sampled_rank};
use crate::limits::joint_limits::LimitParameters;
use crate::tasks::axes::AXIS_NAMES;
use crate::tasks::cartesian::CartesianTask;
use crate::tasks::cartesian_parameters::{CartesianParameters, CenterOfMassParameters};
use crate::tasks::joint::{
    Damping, JointDampingParameters, JointPostureParameters, JointTask, JointTrackingParameters, Posture,
    SelectedJoints, Tracking,
};
use opspace_model::Model;
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// One task of a file: `[task.NAME.KIND]`.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TaskParameters {
    /// A frame that follows a reference on some axes and gives way on others.
    Cartesian(Box<CartesianParameters>),
    /// The centre of mass follows a reference.
    CenterOfMass(Box<CenterOfMassParameters>),
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
    /// How the robot's limits are kept.
    pub limits: LimitParameters,
}

/// The tasks of one robot: those of at most six rows in the order of their priority, and one of all joints below
/// them.
#[derive(Clone, Debug)]
pub(crate) struct Levels {
    pub rows: Vec<Level>,
    pub joint: Option<JointTask>,
    pub nullspace: Nullspace,
}

impl Levels {
    pub(crate) fn new(
        model: &Model,
        stack: &Stack<'_>,
        robot: &ControlContext,
    ) -> Result<Self, ControlError> {
        check_names(stack)?;
        let (mut rows, mut joint) = (Vec::new(), None);
        for (place, name) in stack.priority.iter().enumerate() {
            let task = match &stack.task[name] {
                TaskParameters::Cartesian(p) => {
                    RowTask::Cartesian(Box::new(CartesianTask::new(name, p, model, robot)?))
                }
                TaskParameters::CenterOfMass(p) => {
                    RowTask::Cartesian(Box::new(CartesianTask::of_center_of_mass(name, p, model, robot)?))
                }
                TaskParameters::JointTracking(p @ JointTrackingParameters { joints: Some(joints), .. }) => {
                    RowTask::Joints(Box::new(SelectedJoints::new(name, joints, p, model)?))
                }
                TaskParameters::JointTracking(p) => {
                    joint = Some(JointTask::Tracking(Box::new(Tracking::new(name, p, model)?)));
                    check_last(stack, place)?;
                    continue;
                }
                TaskParameters::JointPosture(p) => {
                    joint = Some(JointTask::Posture(Posture::new(name, p, model)?));
                    check_last(stack, place)?;
                    continue;
                }
                TaskParameters::JointDamping(p) => {
                    joint = Some(JointTask::Damping(Damping::new(name, p, model)?));
                    check_last(stack, place)?;
                    continue;
                }
            };
            rows.push(Level::new(task, model));
            check_rank(model, &rows)?;
        }
        let nullspace = Nullspace::new(model.n(), rows.len());
        Ok(Self { rows, joint, nullspace })
    }

    /// Begins where the robot is.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        self.rows.iter_mut().for_each(|level| level.start(input));
        if let Some(task) = &mut self.joint {
            task.start(input.measurement);
        }
    }

    /// Takes in where the robot is and where it should be.
    pub(crate) fn observe(&mut self, input: &ControlInput<'_>) {
        self.rows.iter_mut().for_each(|level| level.observe(input));
        if let Some(JointTask::Tracking(task)) = &mut self.joint {
            task.observe(input.measurement.q.as_slice(), input.measurement.time_s);
        }
    }

    /// Joins its references from the state of `data`, at rest. Allocates nothing.
    pub(crate) fn resume(&mut self, input: &ControlInput<'_>) {
        self.rows.iter_mut().for_each(|level| level.resume(input));
        if let Some(JointTask::Tracking(task)) = &mut self.joint {
            task.resume(input.data.q.as_slice(), input.measurement.time_s);
        }
    }

    /// Goes on from where another stack stands: tasks of the same name from each other, new ones from where the robot
    /// is. Allocates nothing.
    pub(crate) fn take_over(&mut self, before: &mut Self, input: &ControlInput<'_>) {
        for level in &mut self.rows {
            match before.rows.iter_mut().find(|other| other.name() == level.name()) {
                Some(before) => level.take_over(before, input),
                None => level.start(input),
            }
        }
        if let Some(task) = &mut self.joint {
            match before.joint.as_mut().filter(|other| other.name() == task.name()) {
                Some(before) => task.take_over(before, input.measurement),
                None => task.start(input.measurement),
            }
        }
    }
}

/// A task of all joints must be the last.
fn check_last(stack: &Stack<'_>, place: usize) -> Result<(), ControlError> {
    let Some(below) = stack.priority.get(place + 1) else {
        return Ok(());
    };
    let reason = Reason::NotLast { name: stack.priority[place].clone(), below: below.clone() };
    Err(ControlError::new("priority", reason))
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

/// The last of the levels must be able to move all its rows besides those of the levels above it.
fn check_rank(model: &Model, levels: &[Level]) -> Result<(), ControlError> {
    let all: Vec<Rows<'_>> = levels.iter().map(Level::rank_rows).collect();
    let Some((last, above)) = all.split_last() else {
        return Ok(());
    };
    let name = levels[above.len()].name().to_owned();
    let (axes, above, joints) = (last.count(), above.iter().map(Rows::count).sum::<usize>(), model.n());
    let key = match last {
        Rows::Axes(task) if task.subject.turns() => format!("task.{name}.cartesian.axes"),
        Rows::Axes(_) => format!("task.{name}.center-of-mass.axes"),
        Rows::Joints(_) => format!("task.{name}.joint-tracking.joints"),
    };
    if above + axes > joints {
        return Err(ControlError::new(key, Reason::TooManyAxes { name, axes, above, joints }));
    }
    if let Rows::Axes(task) = last
        && let Some(&turn) = task.axes().iter().find(|&&axis| axis >= 3)
        && orientation_is_coupled(model, task.subject)
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
