//! Errors of a task set, with the key at which they stand in its file.

use opspace_model::{UnknownFrame, UnknownJoint};
use thiserror::Error;

/// A task set that can't be built for this robot.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{key}: {reason}")]
pub struct ControlError {
    key: String,
    reason: Reason,
}

impl ControlError {
    /// An error at a key, given from the root of the task file, as `task.hand.distance.frame`.
    #[must_use]
    pub fn new(key: impl Into<String>, reason: impl Into<Reason>) -> Self {
        Self { key: key.into(), reason: reason.into() }
    }

    /// An error about a number out of its range.
    pub(crate) fn value(key: &str, message: String) -> Self {
        Self::new(key, Reason::Value { message })
    }

    /// Returns the error with its key below another one.
    pub(crate) fn below(self, key: &str) -> Self {
        Self { key: format!("{key}.{}", self.key), reason: self.reason }
    }

    /// Path of the offending value in the task file, its parts joined by dots:
    /// `task.hand.cartesian.frame`.
    #[must_use]
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Reason of the error.
    #[must_use]
    pub fn reason(&self) -> &Reason {
        &self.reason
    }
}

/// Reason for which a value is refused.
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
        /// Number of its axes that are not free.
        axes: usize,
        /// Number of axes of all tasks above it that are not free.
        above: usize,
        /// Number of joints, n.
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
        /// Number of joints, n.
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
        /// Number of its axes that are not free.
        axes: usize,
        /// Number of axes of all tasks above it that are not free.
        above: usize,
        /// Highest rank over the sampled configurations.
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
    /// Axes in motion without gains.
    #[error(
        "axes in motion need `gains` = {{ frequency_rad_per_s, damping_ratio }}, or `impedance` = \
         {{ stiffness_n_per_m, ... }}"
    )]
    NoGains,
    /// Gains and an impedance.
    #[error("`gains` and `impedance` exclude each other: one says how axes in motion follow")]
    GainsTwice,
    /// An impedance that leaves out one of its values.
    #[error("axes in motion of this kind need `{key}`")]
    ImpedanceMissing {
        /// The key.
        key: String,
    },
    /// A damping ratio and a damping.
    #[error("`damping_ratio` and a damping exclude each other: remove one")]
    DampingTwice,
    /// A shaped inertia without a sensor.
    #[error("an inertia other than the arm's own needs the sensed force: force = {{ sensor = \"...\" }}")]
    ShapedInertiaUnsensed,
    /// The centre of mass as something that turns.
    #[error("the centre of mass doesn't turn: only x, y and z can belong to its task")]
    CenterOfMassTurns,
    /// A joint task above others that moves more joints than such a task can.
    #[error("a task of some joints can have {most} of them at most, not {joints}")]
    TooManyJoints {
        /// Number of joints that the task names.
        joints: usize,
        /// Largest number of joints.
        most: usize,
    },
    /// A task that becomes one of another kind while it runs.
    #[error(
        "task '{name}' is {was} and can't become {is} while it runs: give the new task a name of its own"
    )]
    KindChanged {
        /// The task.
        name: String,
        /// Kind of the task of that name so far.
        was: &'static str,
        /// Kind of the new task.
        is: &'static str,
    },
    /// A task whose streamed inputs are not those of the task of its name in another task set.
    #[error(
        "task '{name}' has other streamed inputs in another task set: give the new task a name of its own"
    )]
    InputsChanged {
        /// The task.
        name: String,
    },
    /// A joint task that names no joint, or one twice.
    #[error(
        "`joints` must name at least one joint, and each only once: leave it out for a task of all joints"
    )]
    JointList,
    /// A goal that names neither a position nor an orientation.
    #[error("the goal names neither `position` nor `orientation`")]
    NoGoal,
    /// An orientation to reach, but all rotation axes are free.
    #[error("an orientation is asked for, but the axes rx, ry and rz are all free")]
    OrientationOfFreeAxes,
    /// A recorded path whose file has not been read.
    #[error("the recorded path has no samples: read its file into `samples`")]
    NotRead,
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
    /// Inverse kinematics for a task set that asks for no motion.
    #[error(
        "no task of this stack asks for a motion, so inverse kinematics has nothing to follow: it needs a \
         cartesian or a joint-tracking task"
    )]
    NoMotion,
    /// A number out of its range.
    #[error("{message}")]
    Value {
        /// The range and the number.
        message: String,
    },
    /// A list that should have one number a joint.
    #[error("{given} numbers for {joints} joints")]
    JointCount {
        /// Number of values given.
        given: usize,
        /// Number of joints, n.
        joints: usize,
    },
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "(none)".to_owned() } else { names.join(", ") }
}

fn beside(above: usize) -> String {
    if above == 0 { String::new() } else { format!(" beside the {above} of the tasks above it") }
}
