//! Errors of a task set, each with the key in the task file that causes it.

use opspace_model::{UnknownFrame, UnknownJoint};
use thiserror::Error;

/// Error: the task set cannot be built for this robot.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{key}: {reason}")]
pub struct ControlError {
    key: String,
    reason: Reason,
}

impl ControlError {
    /// Creates an error at a key. The key is the path from the root of the task file, for example
    /// `task.hand.distance.frame`.
    #[must_use]
    pub fn new(key: impl Into<String>, reason: impl Into<Reason>) -> Self {
        Self { key: key.into(), reason: reason.into() }
    }

    /// Creates an error about a number that is out of range.
    pub(crate) fn value(key: &str, message: String) -> Self {
        Self::new(key, Reason::Value { message })
    }

    /// Returns the error with `key` prepended to its own key.
    pub(crate) fn below(self, key: &str) -> Self {
        Self { key: format!("{key}.{}", self.key), reason: self.reason }
    }

    /// Path of the invalid value in the task file, its parts joined by dots: `task.hand.cartesian.frame`.
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

/// Reason why a value is rejected.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum Reason {
    /// The robot has no frame of this name.
    #[error(transparent)]
    Frame(#[from] UnknownFrame),
    /// The robot has no joint of this name.
    #[error(transparent)]
    Joint(#[from] UnknownJoint),
    /// The robot has no force sensor of this name.
    #[error("no force sensor '{name}'; the robot's force sensors are: {}", listed(known))]
    Sensor {
        /// Requested name.
        name: String,
        /// Available names.
        known: Vec<String>,
    },
    /// `priority` contains the name of a task that does not exist.
    #[error("no task '{name}'; the tasks are: {}", listed(known))]
    UnknownTask {
        /// The name in `priority`.
        name: String,
        /// Available names.
        known: Vec<String>,
    },
    /// A task that is missing in `priority`.
    #[error("task '{name}' is not in `priority`: add it there, or remove the task")]
    Unranked {
        /// The task.
        name: String,
    },
    /// A task that is listed twice in `priority`.
    #[error("task '{name}' is in `priority` twice")]
    Repeated {
        /// The task.
        name: String,
    },
    /// A name that is not allowed in keys and signal names.
    #[error("task name '{name}': only letters, digits, '_' and '-' are allowed")]
    Name {
        /// The name.
        name: String,
    },
    /// A task of all joints that has another task below it.
    #[error(
        "task '{name}' is in joint space and uses all remaining degrees of freedom: it must be last in \
         `priority`, but '{below}' is below it"
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
    /// A task that controls, together with the tasks above, more axes than the arm has joints.
    #[error("task '{name}' controls {axes} axes{}, but this arm has only {joints} joints", beside(*above))]
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
    /// Axes that this arm cannot move together with the axes of the tasks above, in any configuration.
    #[error(
        "task '{name}' controls {axes} axes{}, but this arm can move at most {rank} of these {} at once, in any \
         configuration",
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
    /// A per-axis table without a value for an axis that needs one.
    #[error("no value for axis {axis}, which is not free")]
    MissingAxis {
        /// The axis.
        axis: &'static str,
    },
    /// A target force or moment on an axis that does not accept one.
    #[error("axis {axis} accepts no target {what}: it is not a compliant or force axis of that kind")]
    TargetAxis {
        /// The axis.
        axis: &'static str,
        /// `force (N)` or `moment (Nm)`.
        what: &'static str,
    },
    /// Force feedback for a task without a compliant or force axis.
    #[error("force feedback needs at least one axis that is `compliant` or `force`")]
    NothingCompliant,
    /// A value of force control that no axis uses.
    #[error("only `force` axes use it: remove it, or make an axis `force`")]
    NothingIntegrates,
    /// A target force as a function of time on an axis that is not in force control.
    #[error("only `force` axes follow a profile: remove it, or make the axis `force`")]
    ProfileAxis,
    /// A damping of compliant axes without such axes.
    #[error("no axis is `compliant`: remove it; the damping of `force` axes is `force.damping_per_s`")]
    NothingDamped,
    /// Force control without a sensor.
    #[error("a `force` axis needs a sensor and a target: force = {{ sensor = \"...\", target_n = ... }}")]
    ForceAxisUnsensed,
    /// Axes of a surface without a single axis in force control.
    #[error("a surface has one normal: make exactly one of x, y and z `force`")]
    SurfaceNormal,
    /// An admittance on an axis that is not a compliant or force axis of its kind.
    #[error("axis {axis} accepts no such admittance: it is not a compliant or force axis of that kind")]
    AdmittanceAxis {
        /// The axis.
        axis: &'static str,
    },
    /// A force axis without an admittance, for inverse kinematics.
    #[error(
        "inverse kinematics controls the force of axis {axis} by an admittance: give `{key}`, or use the controller `osc`"
    )]
    AdmittanceMissing {
        /// The axis.
        axis: &'static str,
        /// The key.
        key: &'static str,
    },
    /// Motion axes without gains.
    #[error(
        "axes in motion need `gains` = {{ frequency_rad_per_s, damping_ratio }}, or `impedance` = \
         {{ stiffness_n_per_m, ... }}"
    )]
    NoGains,
    /// Both gains and an impedance are given.
    #[error("`gains` and `impedance` are mutually exclusive: give one of them for the axes in motion")]
    GainsTwice,
    /// An impedance without one of the values that it needs.
    #[error("these axes in motion need `{key}`")]
    ImpedanceMissing {
        /// The key.
        key: String,
    },
    /// Both a damping ratio and a damping are given.
    #[error("`damping_ratio` and a damping are mutually exclusive: remove one")]
    DampingTwice,
    /// A gain profile of an axis that is not in motion.
    #[error("axis {axis} accepts no such profile: it is not a motion axis of that kind")]
    GainProfileAxis {
        /// The axis.
        axis: &'static str,
    },
    /// Varying gains together with a desired inertia.
    #[error(
        "a `profile` or a `tank` needs the arm's own inertia: remove `inertia_kg` and `inertia_kg_m2`, or the profile and \
         the tank"
    )]
    VaryingShapedInertia,
    /// A desired inertia without a force sensor.
    #[error("an inertia other than the arm's own needs the measured force: force = {{ sensor = \"...\" }}")]
    ShapedInertiaUnsensed,
    /// A rotation axis for the centre of mass.
    #[error("the centre of mass has no orientation: its task can have only the axes x, y and z")]
    CenterOfMassTurns,
    /// A joint task above other tasks that has more joints than allowed.
    #[error("a task of selected joints can have at most {most} joints, not {joints}")]
    TooManyJoints {
        /// Number of joints in the task.
        joints: usize,
        /// Largest number of joints.
        most: usize,
    },
    /// A task that has a different kind in another task set.
    #[error("task '{name}' is {was} and cannot become {is} during a run: give the new task another name")]
    KindChanged {
        /// The task.
        name: String,
        /// Kind of the existing task of this name.
        was: &'static str,
        /// Kind of the new task.
        is: &'static str,
    },
    /// A task that has different streamed inputs in another task set.
    #[error(
        "task '{name}' has different streamed inputs in another task set: give the new task another name"
    )]
    InputsChanged {
        /// The task.
        name: String,
    },
    /// A joint task whose list of joints is empty or contains a joint twice.
    #[error("`joints` must name at least one joint, and each only once: omit it for a task of all joints")]
    JointList,
    /// A goal without a position and without an orientation.
    #[error("the goal names neither `position` nor `orientation`")]
    NoGoal,
    /// A goal with an orientation while all rotation axes are free.
    #[error("the goal has an orientation, but the axes rx, ry and rz are all free")]
    OrientationOfFreeAxes,
    /// A recorded path whose file has not been read.
    #[error("the recorded path has no samples: read its file into `samples`")]
    NotRead,
    /// An empty list of waypoints.
    #[error("no waypoint: at least one is needed")]
    NoWaypoint,
    /// A waypoint that is not later than the previous one.
    #[error("waypoint {index} at {time_s} s is not after the previous one at {previous_s} s")]
    WaypointTime {
        /// Index of the waypoint, from 0.
        index: usize,
        /// Time of the waypoint, s.
        time_s: f64,
        /// Time of the previous waypoint, s.
        previous_s: f64,
    },
    /// A per-joint table without a value for a joint.
    #[error("no value for joint '{joint}': give one number for all joints, or one per joint")]
    MissingJoint {
        /// The joint.
        joint: String,
    },
    /// Inverse kinematics of a task set without a reference motion.
    #[error(
        "no task of this set has a reference motion for inverse kinematics to follow: add a cartesian or a \
         joint-tracking task"
    )]
    NoMotion,
    /// A number that is out of range.
    #[error("{message}")]
    Value {
        /// Message that states the range and the number.
        message: String,
    },
    /// A list whose length differs from the number of joints.
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
    if above == 0 { String::new() } else { format!(" in addition to the {above} of the tasks above it") }
}
