//! A set of tasks, built and checked for a robot.

use crate::context::ControlContext;
use crate::error::{ControlError, Reason};
use crate::hierarchy::nullspace::Nullspace;
use crate::hierarchy::priority_level::PriorityLevel;
use crate::hierarchy::rank::{TypicalMobility, sampled_rank};
use crate::hierarchy::task_hierarchy::TaskHierarchy;
use crate::hierarchy::task_parameters::{TaskParameters, TaskSetParameters};
use crate::tasks::cartesian::CartesianTask;
use crate::tasks::damping::Damping;
use crate::tasks::joint_task::JointTask;
use crate::tasks::posture::Posture;
use crate::tasks::selected_joints::SelectedJoints;
use crate::tasks::task::Task;
use crate::tasks::tracking::Tracking;
use opspace_model::Model;
use std::fmt;

/// Tasks in the order of their priority, checked for a robot: ready to be carried out or switched to.
pub struct TaskSet(pub(crate) TaskHierarchy);

/// A [`TaskSet`] under construction: tasks are added in the order of their priority.
pub struct TaskSetBuilder<'a> {
    model: &'a Model,
    context: &'a ControlContext,
    hierarchy: TaskHierarchy,
}

impl TaskSet {
    /// A set without tasks, to be extended in the order of priority.
    #[must_use]
    pub fn builder<'a>(model: &'a Model, context: &'a ControlContext) -> TaskSetBuilder<'a> {
        TaskSetBuilder { model, context, hierarchy: TaskHierarchy::new(model.n()) }
    }

    /// The tasks of a file.
    ///
    /// # Errors
    /// Names that the robot doesn't have, axes that it can't move, gains that are missing: see [`Reason`].
    pub fn from_parameters(
        model: &Model,
        parameters: &TaskSetParameters<'_>,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        check_names(parameters)?;
        let mut builder = Self::builder(model, context);
        for name in parameters.priority {
            builder = builder.from_parameters(name, &parameters.task[name])?;
        }
        Ok(builder.build())
    }

    /// Tasks of at most six rows, the most important first.
    pub fn tasks(&self) -> impl Iterator<Item = &dyn Task> {
        self.0.tasks()
    }

    /// Typical mobilities of [`tasks`](Self::tasks), to which their thresholds of damping are relative.
    pub fn typical_mobilities(&self) -> impl Iterator<Item = TypicalMobility> {
        self.0.levels.iter().map(|level| level.typical)
    }

    /// The task of all joints.
    #[must_use]
    pub fn joint_task(&self) -> Option<&dyn JointTask> {
        self.0.joint.as_deref()
    }
}

impl fmt::Debug for TaskSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = self.tasks().map(Task::name).chain(self.joint_task().map(JointTask::name));
        f.debug_list().entries(names).finish()
    }
}

impl TaskSetBuilder<'_> {
    /// Adds a task below those added so far.
    ///
    /// # Errors
    /// A name that is taken or can't be part of a signal's name; rows that the arm can't move, or not beside those of
    /// the tasks above; a task of all joints above it.
    pub fn task(mut self, task: Box<dyn Task>) -> Result<Self, ControlError> {
        self.check_name(task.name())?;
        self.hierarchy.levels.push(PriorityLevel::new(task, self.model));
        check_rank(self.model, &self.hierarchy)?;
        Ok(self)
    }

    /// Adds a task of all joints, the last one.
    ///
    /// # Errors
    /// As [`task`](Self::task).
    pub fn joint_task(mut self, task: Box<dyn JointTask>) -> Result<Self, ControlError> {
        self.check_name(task.name())?;
        self.hierarchy.joint = Some(task);
        Ok(self)
    }

    /// Adds a task by its parameters.
    ///
    /// # Errors
    /// Parameters that don't fit the robot, and as [`task`](Self::task).
    pub fn from_parameters(self, name: &str, parameters: &TaskParameters) -> Result<Self, ControlError> {
        let (model, context) = (self.model, self.context);
        match parameters {
            TaskParameters::Cartesian(p) => self.task(Box::new(CartesianTask::new(name, p, model, context)?)),
            TaskParameters::CenterOfMass(p) => {
                self.task(Box::new(CartesianTask::of_center_of_mass(name, p, model, context)?))
            }
            TaskParameters::Swivel(p) => self.task(Box::new(p.task(name, model)?)),
            TaskParameters::Registered(p) => self.task(p.task(name, model, context)?),
            TaskParameters::JointTracking(p) => match &p.joints {
                Some(joints) => self.task(Box::new(SelectedJoints::new(name, joints, p, model)?)),
                None => self.joint_task(Box::new(Tracking::new(name, p, model)?)),
            },
            TaskParameters::JointPosture(p) => self.joint_task(Box::new(Posture::new(name, p, model)?)),
            TaskParameters::JointDamping(p) => self.joint_task(Box::new(Damping::new(name, p, model)?)),
        }
    }

    /// The finished set.
    #[must_use]
    pub fn build(mut self) -> TaskSet {
        self.hierarchy.nullspace = Nullspace::new(self.model.n(), self.hierarchy.levels.len());
        TaskSet(self.hierarchy)
    }

    /// A new task's name must be plain and free; nothing may come below a task of all joints.
    fn check_name(&self, name: &str) -> Result<(), ControlError> {
        let in_priority = |reason| Err(ControlError::new("priority", reason));
        if !is_plain(name) {
            return Err(ControlError::new(format!("task.{name}"), Reason::Name { name: name.to_owned() }));
        }
        if let Some(last) = &self.hierarchy.joint {
            return in_priority(Reason::NotLast { name: last.name().to_owned(), below: name.to_owned() });
        }
        if self.hierarchy.tasks().any(|task| task.name() == name) {
            return in_priority(Reason::Repeated { name: name.to_owned() });
        }
        Ok(())
    }
}

/// Returns true if a name can be part of a key and of a signal's name.
fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    !name.is_empty() && name.chars().all(plain)
}

/// `priority` and the tasks must name each other, one to one.
fn check_names(parameters: &TaskSetParameters<'_>) -> Result<(), ControlError> {
    let in_priority = |reason| Err(ControlError::new("priority", reason));
    for (place, name) in parameters.priority.iter().enumerate() {
        if !parameters.task.contains_key(name) {
            let known = parameters.task.keys().cloned().collect();
            return in_priority(Reason::UnknownTask { name: name.clone(), known });
        }
        if parameters.priority[..place].contains(name) {
            return in_priority(Reason::Repeated { name: name.clone() });
        }
    }
    for name in parameters.task.keys() {
        let key = format!("task.{name}");
        if !is_plain(name) {
            return Err(ControlError::new(key, Reason::Name { name: name.clone() }));
        }
        if !parameters.priority.contains(name) {
            return Err(ControlError::new(key, Reason::Unranked { name: name.clone() }));
        }
    }
    Ok(())
}

/// The last of the levels must be able to move all its rows besides those of the levels above it.
fn check_rank(model: &Model, hierarchy: &TaskHierarchy) -> Result<(), ControlError> {
    let all: Vec<&dyn Task> = hierarchy.tasks().collect();
    let Some((last, above)) = all.split_last() else {
        return Ok(());
    };
    let name = last.name().to_owned();
    let (axes, above, joints) = (last.rows(), above.iter().map(|task| task.rows()).sum::<usize>(), model.n());
    if above + axes > joints {
        return Err(ControlError::new(last.rows_key(), Reason::TooManyAxes { name, axes, above, joints }));
    }
    if let Some(error) = last.infeasibility(model) {
        return Err(error);
    }
    let rank = sampled_rank(model, &all);
    if rank < above + axes {
        return Err(ControlError::new(last.rows_key(), Reason::RankDeficient { name, axes, above, rank }));
    }
    Ok(())
}
