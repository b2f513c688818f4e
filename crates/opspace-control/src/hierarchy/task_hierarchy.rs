//! The tasks of a robot in the order of their priority.

use crate::controller::{ControlInput, StaleTarget};
use crate::hierarchy::nullspace::Nullspace;
use crate::hierarchy::priority_level::PriorityLevel;
use crate::targets::{AllowedInputs, TargetPlace, Targets};
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::{Task, TaskInput};
use opspace_backend::Signal;

/// Tasks of at most six rows, the most important first, and one of all joints below them.
pub(crate) struct TaskHierarchy {
    pub levels: Vec<PriorityLevel>,
    pub joint: Option<Box<dyn JointTask>>,
    pub nullspace: Nullspace,
    /// Places of the streamed inputs of the task of all joints.
    joint_target: TargetPlace,
}

impl TaskHierarchy {
    /// A hierarchy without a task, for `n` joints.
    pub(crate) fn new(n: usize) -> Self {
        Self {
            levels: Vec::new(),
            joint: None,
            nullspace: Nullspace::new(n, 0),
            joint_target: TargetPlace::default(),
        }
    }

    /// Tasks of at most six rows, the most important first.
    pub(crate) fn tasks(&self) -> impl Iterator<Item = &dyn Task> {
        self.levels.iter().map(|level| &*level.task)
    }

    /// Begins at the robot's present state.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.task.start(input));
        if let Some(task) = &mut self.joint {
            task.start(input);
        }
    }

    /// Takes in state and references, in cycles without torques.
    pub(crate) fn observe(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.observe(input));
        let input = self.joint_input(input);
        if let Some(task) = &mut self.joint {
            task.observe(&input);
        }
    }

    /// Input of the task of all joints.
    pub(crate) fn joint_input<'a>(&self, control: &ControlInput<'a>) -> TaskInput<'a> {
        let target = self.joint_target.of(control.targets, control.clock_s);
        TaskInput { control: *control, limited: false, target }
    }

    /// Resolves the places of the tasks' inputs. Allocates nothing.
    pub(crate) fn bind(&mut self, targets: &Targets) {
        for level in &mut self.levels {
            level.target = targets.place(level.task.name());
        }
        if let Some(task) = &self.joint {
            self.joint_target = targets.place(task.name());
        }
    }

    /// Name and inputs of each task that has some.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = (&str, Vec<Signal>, AllowedInputs)> {
        let tasks = self.tasks().map(|task| (task.name(), task.inputs(), task.allowed_inputs()));
        let joint = self.joint.iter().map(|task| (task.name(), task.inputs(), AllowedInputs::default()));
        tasks.chain(joint).filter(|(_, inputs, _)| !inputs.is_empty())
    }

    /// The first stale target for which the robot is to be stopped.
    pub(crate) fn stale_target(&self) -> Option<StaleTarget> {
        let ages = self.tasks().map(Task::stop_for_age_s);
        let mut ages = ages.chain(self.joint.iter().map(|task| task.stop_for_age_s())).enumerate();
        ages.find_map(|(task, age_s)| age_s.map(|age_s| StaleTarget { task, age_s }))
    }

    /// Joins the references from the state of `input.data`, at rest. Allocates nothing.
    pub(crate) fn resume(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.resume(input));
        if let Some(task) = &mut self.joint {
            task.resume(input);
        }
    }

    /// Continues from another hierarchy: tasks of the same name from each other, new ones at the robot's present state.
    /// Allocates nothing.
    pub(crate) fn inherit(&mut self, before: &mut Self, input: &ControlInput<'_>) {
        for level in &mut self.levels {
            level.limited = false;
            match before.levels.iter_mut().find(|other| other.name() == level.name()) {
                Some(before) => level.task.inherit(&mut *before.task, input),
                None => level.task.start(input),
            }
        }
        if let Some(task) = &mut self.joint {
            match before.joint.as_mut().filter(|other| other.name() == task.name()) {
                Some(before) => task.inherit(&mut **before, input),
                None => task.start(input),
            }
        }
    }
}
