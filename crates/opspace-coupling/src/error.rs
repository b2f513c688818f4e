//! Mistakes in the parameters of a coupled task.

use opspace_control::Reason;
use thiserror::Error;

/// Mistake in the parameters of a coupled task.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub(crate) enum Mistake {
    /// Both a frame and joints, or neither.
    #[error("give either `frame` or `joints`")]
    FrameOrJoints,
    /// Axes of joints.
    #[error("`axes` belongs to a `frame`: remove it")]
    AxesOfJoints,
    /// List of axes that is empty or contains an axis twice.
    #[error("`axes` must name at least one axis, and each only once")]
    AxisList,
    /// Coupling that needs the force on the robot, for a task without a sensor.
    #[error("{what} needs the force on the robot: name a force sensor or an estimated force as `sensor`")]
    Unsensed {
        /// The part of the coupling.
        what: &'static str,
    },
    /// Robots that carry an object with rows other than x, y and z of a frame.
    #[error("hands that carry an object need a `frame` with the axes x, y and z, and a `sensor`")]
    CarryRows,
    /// Direction of length zero.
    #[error("a direction must not be zero")]
    ZeroLength,
    /// Law without a side, or the reverse, or two laws.
    #[error(
        "give `side` and one of `teleoperation` and `carry`, or none of them: the file of an experiment writes them"
    )]
    Side,
    /// Clutch that closes before it opens.
    #[error(
        "the clutch opens at {from_s} s and closes at {until_s} s: give times in order, each after the previous one"
    )]
    ClutchTimes {
        /// Time at which it opens, s.
        from_s: f64,
        /// Time at which it closes, s.
        until_s: f64,
    },
    /// Inverse kinematics of a coupled task.
    #[error("a coupled task commands forces, which inverse kinematics does not: use the controller `osc`")]
    Kinematics,
}

impl From<Mistake> for Reason {
    fn from(mistake: Mistake) -> Self {
        Self::Value { message: mistake.to_string() }
    }
}
