//! Contact that activates a task set before its scheduled time.

use crate::hierarchy::task_hierarchy::TaskHierarchy;
use crate::tasks::task::Task;

/// Contact of a task's force axes that approach.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactCondition {
    /// Name of the task.
    pub task: String,
    /// True if all these axes must be in contact, false if one must not.
    pub made: bool,
    /// Time for which this must last, s.
    pub for_s: f64,
}

/// A condition, with the time since which it holds.
#[derive(Clone, Debug)]
pub(crate) struct AwaitedContact {
    condition: ContactCondition,
    since_s: Option<f64>,
}

impl AwaitedContact {
    pub(crate) fn new(condition: ContactCondition) -> Self {
        Self { condition, since_s: None }
    }

    /// Returns true if the condition has held for long enough at `time_s` (s). Call it in each cycle.
    pub(crate) fn is_met(&mut self, active: &TaskHierarchy, time_s: f64) -> bool {
        let ContactCondition { task, made, for_s } = &self.condition;
        let contact = active.tasks().find(|known| known.name() == task).and_then(Task::contact_made);
        if contact != Some(*made) {
            self.since_s = None;
            return false;
        }
        time_s - *self.since_s.get_or_insert(time_s) >= *for_s
    }
}
