//! Clutch of a task: poses are followed relative to where both were when it closed.

use nalgebra::Matrix3;
use opspace_model::Placement;

/// Clutch of a task. Without a message about it, poses are followed as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Clutch {
    /// Poses are followed as they are.
    #[default]
    Unused,
    /// Poses are not followed.
    Open,
    /// Closed; the next pose is where the motion begins.
    Closing,
    /// Poses are followed from here on.
    Closed {
        /// Pose at which the motion began.
        pose: Placement,
        /// Placement of the task then.
        task: Placement,
    },
}

impl Clutch {
    /// Opens or closes the clutch.
    pub fn set(&mut self, is_closed: bool) {
        match (is_closed, &*self) {
            (false, _) => *self = Self::Open,
            (true, Self::Open | Self::Unused) => *self = Self::Closing,
            (true, _) => {}
        }
    }

    /// Target for a pose in the world, when the task is at `task`; `None` if it is not followed. The displacement of the pose
    /// in world axes is that of the target.
    pub fn target(&mut self, pose: &Placement, task: &Placement) -> Option<Placement> {
        if *self == Self::Closing {
            *self = Self::Closed { pose: *pose, task: *task };
        }
        match self {
            Self::Unused => Some(*pose),
            Self::Open | Self::Closing => None,
            Self::Closed { pose: first, task } => {
                let turned: Matrix3<f64> = pose.rotation * first.rotation.transpose();
                Some(Placement {
                    rotation: turned * task.rotation,
                    translation: task.translation + (pose.translation - first.translation),
                })
            }
        }
    }
}
