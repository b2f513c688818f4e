//! What can be wrong with a stack of tasks, and where in its file it stands.

use opspace_model::{UnknownFrame, UnknownJoint};
use thiserror::Error;

/// A stack of tasks that can't be built for this robot.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{key}: {reason}")]
pub struct ControlError {
    key: String,
    reason: Reason,
}

impl ControlError {
    pub(crate) fn new(key: impl Into<String>, reason: impl Into<Reason>) -> Self {
        Self { key: key.into(), reason: reason.into() }
    }

    /// Path of the offending value in the task file, its parts joined by dots:
    /// `task.hand.cartesian.frame`.
    #[must_use]
    pub fn key(&self) -> &str {
        &self.key
    }

    /// What is wrong with it.
    #[must_use]
    pub fn reason(&self) -> &Reason {
        &self.reason
    }
}

/// What is wrong with a value.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Reason {
    /// The robot has no such frame.
    #[error(transparent)]
    Frame(#[from] UnknownFrame),
    /// The robot has no such joint.
    #[error(transparent)]
    Joint(#[from] UnknownJoint),
    /// The robot has no such force sensor.
    #[error("no force sensor '{name}'; the robot's are: {}", listed(known))]
    Sensor {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// `priority` names a task that isn't there.
    #[error("no task '{name}'; the tasks are: {}", listed(known))]
    UnknownTask {
        /// The name in `priority`.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// A task without a place in `priority`.
    #[error("task '{name}' is not in `priority`: give it a place there, or remove it")]
    Unranked {
        /// The task.
        name: String,
    },
    /// A task twice in `priority`.
    #[error("task '{name}' stands twice in `priority`")]
    Repeated {
        /// The task.
        name: String,
    },
    /// A name that can't be part of a key or a signal's name.
    #[error("task name '{name}': letters, digits, '_' and '-' only")]
    Name {
        /// The name.
        name: String,
    },
    /// A joint-space task above another task.
    #[error(
        "task '{name}' is in joint space and takes all the freedom that is left: it must be last in \
         `priority`, but '{below}' stands below it"
    )]
    NotLast {
        /// The joint-space task.
        name: String,
        /// The task below it.
        below: String,
    },
    /// A Cartesian task whose axes are all free.
    #[error(
        "all axes are free: at least one of x, y, z, rx, ry, rz must be `motion`, `compliant` or `force`"
    )]
    NoAxis,
    /// More axes than joints.
    #[error("task '{name}' asks for {axes} axes{}, this arm has {joints} joints", beside(*above))]
    TooManyAxes {
        /// The task.
        name: String,
        /// Its axes that are not free.
        axes: usize,
        /// The same of all tasks above it.
        above: usize,
        /// n.
        joints: usize,
    },
    /// A rotation axis for a frame that this arm can't turn on the spot.
    #[error(
        "task '{name}' asks for axis {axis}, but this arm of {joints} joints can't turn the frame without moving \
         it, wherever it stands: leave rx, ry and rz free"
    )]
    CoupledOrientation {
        /// The task.
        name: String,
        /// The rotation axis.
        axis: &'static str,
        /// n.
        joints: usize,
    },
    /// Axes that this arm can't move, or not beside those of the tasks above, wherever it stands.
    #[error(
        "task '{name}' asks for {axes} axes{}, but wherever this arm stands it can move only {rank} of \
         these {} at once",
        beside(*above),
        above + axes
    )]
    RankDeficient {
        /// The task.
        name: String,
        /// Its axes that are not free.
        axes: usize,
        /// The same of all tasks above it.
        above: usize,
        /// The highest rank found.
        rank: usize,
    },
    /// A per-axis table that leaves out an axis which needs a value.
    #[error("no value for axis {axis}, which is not free")]
    MissingAxis {
        /// The axis.
        axis: &'static str,
    },
    /// A target force or moment on an axis that doesn't take one.
    #[error("axis {axis} takes no {what} here: it is not a compliant or force axis of that kind")]
    TargetAxis {
        /// The axis.
        axis: &'static str,
        /// `force (N)` or `moment (Nm)`.
        what: &'static str,
    },
    /// Force feedback on a task without compliant or force axis.
    #[error("force feedback needs at least one axis that is `compliant` or `force`")]
    NothingCompliant,
    /// An integral that no axis uses.
    #[error("only `force` axes integrate the force error: remove it, or make an axis `force`")]
    NothingIntegrates,
    /// Force control without a sensor.
    #[error("a `force` axis needs a sensor and a target: force = {{ sensor = \"...\", target_n = ... }}")]
    ForceAxisUnsensed,
    /// A goal that names neither a position nor an orientation.
    #[error("the goal names neither `position` nor `orientation`")]
    NoGoal,
    /// An orientation to reach, but all rotation axes are free.
    #[error("an orientation is asked for, but the axes rx, ry and rz are all free")]
    OrientationOfFreeAxes,
    /// A list of waypoints without one.
    #[error("no waypoint: at least one is needed")]
    NoWaypoint,
    /// Waypoints that go back in time.
    #[error("waypoint {index} at {time_s} s does not come after {previous_s} s")]
    WaypointTime {
        /// Its place in the list, from 0.
        index: usize,
        /// Its time, s.
        time_s: f64,
        /// The time before it, s.
        previous_s: f64,
    },
    /// A per-joint table that leaves out a joint.
    #[error("no value for joint '{joint}': give one number for all joints, or one for each")]
    MissingJoint {
        /// The joint.
        joint: String,
    },
    /// Inverse kinematics for a stack that asks for no motion.
    #[error(
        "no task of this stack asks for a motion, so inverse kinematics has nothing to follow: it needs a \
         cartesian or a joint-tracking task"
    )]
    NoMotion,
    /// A list that should have one number a joint.
    #[error("{given} numbers for {joints} joints")]
    JointCount {
        /// How many there are.
        given: usize,
        /// n.
        joints: usize,
    },
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "(none)".to_owned() } else { names.join(", ") }
}

fn beside(above: usize) -> String {
    if above == 0 { String::new() } else { format!(" beside the {above} of the tasks above it") }
}
