//! Interface of a kind of tasks: from the parameters in a file to the task.

use crate::context::ControlContext;
use crate::error::ControlError;
use crate::references::joint_reference::JointReference;
use crate::references::reference::CartesianReference;
use crate::references::scalar_reference::ScalarReference;
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::Task;
use opspace_model::Model;

/// Parameters of a task, which build it for a robot.
pub trait BuildTask {
    /// Builds the task with this name.
    ///
    /// # Errors
    /// Parameters that do not match the robot.
    fn build(&self, name: &str, model: &Model, context: &ControlContext) -> Result<BuiltTask, ControlError>;

    /// Reference of the task; `None` if it has none, or none of these kinds.
    fn reference(&self) -> Option<TaskReference<'_>> {
        None
    }

    /// Key of the natural frequency (rad/s) of the feedback, below the kind of the task; `None` if no key sets it.
    fn frequency_key(&self) -> Option<&'static [&'static str]> {
        Some(&["gains", "frequency_rad_per_s"])
    }
}

/// Task that is ready to be added to a task set.
pub enum BuiltTask {
    /// Task of some rows.
    Rows(Box<dyn Task>),
    /// Task of all joints, the last one in the order of priority.
    Joints(Box<dyn JointTask>),
}

/// Reference in the parameters of a task.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TaskReference<'a> {
    /// Reference of a pose.
    Cartesian(&'a CartesianReference),
    /// Reference of joints.
    Joint(&'a JointReference),
    /// Reference of a coordinate.
    Scalar(&'a ScalarReference),
}

impl BuiltTask {
    /// Wraps a task of some rows.
    pub(crate) fn rows(task: impl Task) -> Self {
        Self::Rows(Box::new(task))
    }

    /// Wraps a task of all joints.
    pub(crate) fn joints(task: impl JointTask) -> Self {
        Self::Joints(Box::new(task))
    }
}

impl<T: BuildTask + ?Sized> BuildTask for Box<T> {
    fn build(&self, name: &str, model: &Model, context: &ControlContext) -> Result<BuiltTask, ControlError> {
        (**self).build(name, model, context)
    }

    fn reference(&self) -> Option<TaskReference<'_>> {
        (**self).reference()
    }

    fn frequency_key(&self) -> Option<&'static [&'static str]> {
        (**self).frequency_key()
    }
}
