//! The tasks of a robot in the order of their priority.

use crate::controller::{ControlInput, StaleTarget};
use crate::hierarchy::nullspace::Nullspace;
use crate::hierarchy::priority_level::PriorityLevel;
use crate::targets::{AllowedInputs, TargetPlace, Targets};
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::{Task, TaskInput};
use opspace_backend::Signal;

/// Tasks of at most six rows in order of priority, and at most one task of all joints below them.
pub(crate) struct TaskHierarchy {
    pub levels: Vec<PriorityLevel>,
    pub joint: Option<Box<dyn JointTask>>,
    pub nullspace: Nullspace,
    /// Positions of the joint task's streamed inputs in the row of targets.
    joint_target: TargetPlace,
}

impl TaskHierarchy {
    /// Creates an empty hierarchy for `n` joints.
    pub(crate) fn new(n: usize) -> Self {
        Self {
            levels: Vec::new(),
            joint: None,
            nullspace: Nullspace::new(n, 0),
            joint_target: TargetPlace::default(),
        }
    }

    /// Tasks of at most six rows, the highest priority first.
    pub(crate) fn tasks(&self) -> impl Iterator<Item = &dyn Task> {
        self.levels.iter().map(|level| &*level.task)
    }

    /// Returns true if the levels leave some motion of `n` joints: degrees of freedom, or a damped direction. The
    /// damping of inversions for comparisons does not count: it is compared as published, without a brake.
    pub(crate) fn leaves_freedom(&self, n: usize) -> bool {
        let rows: usize = self.levels.iter().map(|level| level.task.rows()).sum();
        rows < n || self.levels.iter().any(PriorityLevel::is_damped)
    }

    /// Starts all tasks at the robot's present state.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.task.start(input));
        if let Some(task) = &mut self.joint {
            task.start(input);
        }
    }

    /// Updates states and references in a cycle without torque command.
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

    /// Looks up the positions of the tasks' inputs in the row of targets. Allocates nothing.
    pub(crate) fn bind(&mut self, targets: &Targets) {
        for level in &mut self.levels {
            level.target = targets.place(level.task.name());
        }
        if let Some(task) = &self.joint {
            self.joint_target = targets.place(task.name());
        }
    }

    /// Name and inputs of each task that has inputs.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = (&str, Vec<Signal>, AllowedInputs)> {
        let tasks = self.tasks().map(|task| (task.name(), task.inputs(), task.allowed_inputs()));
        let joint = self.joint.iter().map(|task| (task.name(), task.inputs(), AllowedInputs::default()));
        tasks.chain(joint).filter(|(_, inputs, _)| !inputs.is_empty())
    }

    /// Returns the first stale target that requires the robot to stop.
    pub(crate) fn stale_target(&self) -> Option<StaleTarget> {
        let ages = self.tasks().map(Task::stop_for_age_s);
        let mut ages = ages.chain(self.joint.iter().map(|task| task.stop_for_age_s())).enumerate();
        ages.find_map(|(task, age_s)| age_s.map(|age_s| StaleTarget { task, age_s }))
    }

    /// Blends from the state of `input.data`, at rest, into the references. Allocates nothing.
    pub(crate) fn resume(&mut self, input: &ControlInput<'_>) {
        self.levels.iter_mut().for_each(|level| level.resume(input));
        if let Some(task) = &mut self.joint {
            task.resume(input);
        }
    }

    /// Continues from another hierarchy: each task continues from the task of the same name in `before`; a task without
    /// one starts at the robot's present state. Allocates nothing.
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
