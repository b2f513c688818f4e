//! A set of tasks, built and checked for a robot.

use crate::context::ControlContext;
use crate::error::{ControlError, Reason};
use crate::hierarchy::priority_level::PriorityLevel;
use crate::hierarchy::rank::{TypicalMobility, have_same_rows, sampled_rank};
use crate::hierarchy::task_hierarchy::TaskHierarchy;
use crate::hierarchy::task_parameters::{TaskParameters, TaskSetParameters, largest_unused_damping_per_s};
use crate::nullspace::Nullspace;
use crate::tasks::build_task::{BuildTask, BuiltTask};
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::Task;
use opspace_backend::quantity::Positive;
use opspace_model::Model;
use std::fmt;

/// Tasks in order of priority, checked for a robot and ready to be executed.
pub struct TaskSet(pub(crate) TaskHierarchy);

/// Builder of a [`TaskSet`]; tasks are added in order of priority.
pub struct TaskSetBuilder<'a> {
    model: &'a Model,
    context: &'a ControlContext,
    hierarchy: TaskHierarchy,
    /// Task set of the same robot: rank and typical mobility of the same rows are not computed again.
    before: Option<&'a TaskSet>,
}

impl TaskSet {
    /// Returns a builder without tasks; tasks are added in order of priority.
    #[must_use]
    pub fn builder<'a>(model: &'a Model, context: &'a ControlContext) -> TaskSetBuilder<'a> {
        TaskSetBuilder { model, context, hierarchy: TaskHierarchy::new(model), before: None }
    }

    /// Builds the task set of a task file. With a task set `before` it for the same robot, what both have in common is
    /// computed faster, with the same result.
    ///
    /// # Errors
    /// Unknown names, axes that the robot cannot move, missing gains: see [`Reason`].
    pub fn from_parameters(
        model: &Model,
        parameters: &TaskSetParameters<'_>,
        context: &ControlContext,
        before: Option<&Self>,
    ) -> Result<Self, ControlError> {
        check_names(parameters)?;
        let builder = TaskSetBuilder { before, ..Self::builder(model, context) };
        let mut builder = builder.unused_damping(parameters.unused_damping_per_s)?;
        for name in parameters.priority {
            builder = builder.from_parameters(name, &parameters.task[name])?;
        }
        Ok(builder.build())
    }

    /// Tasks of at most six rows, the highest priority first.
    pub fn tasks(&self) -> impl Iterator<Item = &dyn Task> {
        self.0.tasks()
    }

    /// Typical mobilities of [`tasks`](Self::tasks); the damping thresholds are relative to them.
    pub fn typical_mobilities(&self) -> impl Iterator<Item = TypicalMobility> {
        self.0.levels.iter().map(|level| level.typical)
    }

    /// The task of all joints, if there is one.
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
    /// Adds a task below the tasks added so far.
    ///
    /// # Errors
    /// A name that is already used or is not allowed in signal names; rows that the arm cannot move, alone or together
    /// with the rows of the tasks above; a task of all joints above it.
    pub fn task(mut self, task: Box<dyn Task>) -> Result<Self, ControlError> {
        self.check_name(task.name())?;
        let (model, above) = (self.model, self.hierarchy.levels.len());
        let known = self.known_mobility(&*task);
        let typical = known.unwrap_or_else(|| TypicalMobility::new(model, self.hierarchy.tasks(), &*task));
        self.hierarchy.levels.push(PriorityLevel::new(task, typical, model, self.context, above));
        if known.is_none() {
            check_rank(model, &self.hierarchy)?;
        }
        Ok(self)
    }

    /// Typical mobility of a task below the tasks added so far, if the task set before has the same rows up to there.
    fn known_mobility(&self, task: &dyn Task) -> Option<TypicalMobility> {
        let before = self.before?;
        let tasks: Vec<&dyn Task> = self.hierarchy.tasks().chain([task]).collect();
        let others: Vec<&dyn Task> = before.tasks().take(tasks.len()).collect();
        let typical = before.0.levels.get(tasks.len() - 1)?.typical;
        have_same_rows(self.model, &tasks, &others).then_some(typical)
    }

    /// Adds the task of all joints, which must be the last one.
    ///
    /// # Errors
    /// As for [`task`](Self::task), except for the check of the rows.
    pub fn joint_task(mut self, task: Box<dyn JointTask>) -> Result<Self, ControlError> {
        self.check_name(task.name())?;
        self.hierarchy.joint = Some(task);
        Ok(self)
    }

    /// Sets the damping of the motion that the tasks leave, if there is no task of all joints (deceleration per velocity),
    /// 1/s.
    ///
    /// # Errors
    /// A damping above a fifth of the control rate.
    pub fn unused_damping(mut self, damping_per_s: Positive) -> Result<Self, ControlError> {
        let (damping_per_s, most) =
            (damping_per_s.get(), largest_unused_damping_per_s(self.context.period_s));
        if damping_per_s > most {
            let message = format!(
                "{damping_per_s} 1/s is above {most} 1/s, a fifth of the control rate: with the delay of a command, \
                 stronger damping sets motion on instead of braking it"
            );
            return Err(ControlError::value("unused_damping_per_s", message));
        }
        self.hierarchy.unused_damping_per_s = damping_per_s;
        Ok(self)
    }

    /// Adds a task by its parameters.
    ///
    /// # Errors
    /// Parameters that do not match the robot, and the errors of [`task`](Self::task).
    pub fn from_parameters(self, name: &str, parameters: &TaskParameters) -> Result<Self, ControlError> {
        match parameters.build(name, self.model, self.context)? {
            BuiltTask::Rows(task) => self.task(task),
            BuiltTask::Joints(task) => self.joint_task(task),
        }
    }

    /// Returns the finished task set.
    #[must_use]
    pub fn build(mut self) -> TaskSet {
        self.hierarchy.nullspace = Nullspace::new(self.model.n(), self.hierarchy.levels.len());
        TaskSet(self.hierarchy)
    }

    /// Checks that a new task's name is allowed and not yet used, and that no task of all joints is above it.
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

/// Returns true if a name can be part of a key and of a signal name.
fn is_plain(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    !name.is_empty() && name.chars().all(plain)
}

/// Checks that `priority` and the tasks have the same names, each once.
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

/// Checks that the arm can move all rows of the last level together with the rows of the levels above.
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
    let rank = sampled_rank(model, &all);
    if rank < above + axes {
        return Err(ControlError::new(last.rows_key(), Reason::RankDeficient { name, axes, above, rank }));
    }
    Ok(())
}
