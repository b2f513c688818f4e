//! Parameters of the joint-space tasks, and the gains of each joint.
//!
//! ```text
//! q̈* = q̈_d + 2ζω (q̇_d − q̇) + ω² (q_d − q)
//! ```

use crate::error::ControlError;
use crate::per_joint::PerJoint;
use crate::references::joint_reference::JointReference;
use crate::tasks::when_limited::WhenLimited;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::Model;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The joints follow a reference.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct JointTrackingParameters {
    /// The joints of the task, at most six: tasks below can use the others. A task of all joints must be the last.
    #[cfg_attr(feature = "schema", schemars(extend("minItems" = 1, "uniqueItems" = true, "x-default" = "all joints")))]
    pub joints: Option<Vec<String>>,
    /// Reference of the joints.
    pub reference: JointReference,
    /// Gains of the tracking error.
    pub gains: JointGains,
    /// Weight of each joint when limits are in force: a deviation of its acceleration counts this many times in the kinetic
    /// energy, so that limits take from joints of small weight first. The largest is at most 100 times the smallest.
    /// Without an active limit, weights change nothing.
    #[serde(default = "equal_weights")]
    pub weight: PerJoint<Positive>,
    /// Change of the acceleration that limits do not allow.
    #[serde(default)]
    pub when_limited: WhenLimited,
}

/// Feedback of a joint: a unit inertia with a spring and a damper, independent of the arm's inertia.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct JointGains {
    /// Natural frequency ω of the error, rad/s: the stiffness is ω² (1/s²).
    pub frequency_rad_per_s: PerJoint<Positive>,
    /// Damping ratio ζ of the error: the damping is 2ζω (1/s).
    pub damping_ratio: PerJoint<NonNegative>,
}

/// Springs pull the joints to a posture.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct JointPostureParameters {
    /// Posture by joint names, rad (m for a prismatic joint); joints that are not named keep their start position.
    #[serde(default)]
    pub posture_rad: BTreeMap<String, f64>,
    /// Natural frequency ω of the error, rad/s: the stiffness is ω² (1/s²).
    pub frequency_rad_per_s: PerJoint<Positive>,
    /// Damping ratio ζ of the error: the damping is 2ζω (1/s).
    pub damping_ratio: PerJoint<NonNegative>,
    /// Weight of each joint when limits are in force: a deviation of its acceleration counts this many times in the kinetic
    /// energy, so that limits take from joints of small weight first. The largest is at most 100 times the smallest.
    /// Without an active limit, weights change nothing.
    #[serde(default = "equal_weights")]
    pub weight: PerJoint<Positive>,
}

/// The joints are damped in proportion to their velocity.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct JointDampingParameters {
    /// Damping, Nms/rad (Ns/m for a prismatic joint); may be 0.
    pub damping_nms_per_rad: PerJoint<NonNegative>,
}

fn equal_weights() -> PerJoint<Positive> {
    PerJoint::All(Positive::literal(1.0))
}

impl JointGains {
    /// Creates gains with one natural frequency (rad/s) and one damping ratio for all joints.
    ///
    /// # Errors
    /// A frequency that is not positive, a negative ratio.
    pub fn new(frequency_rad_per_s: f64, damping_ratio: f64) -> Result<Self, ControlError> {
        let frequency = Positive::try_from(frequency_rad_per_s);
        let ratio = NonNegative::try_from(damping_ratio);
        Ok(Self {
            frequency_rad_per_s: PerJoint::All(
                frequency.map_err(|message| ControlError::value("frequency_rad_per_s", message))?,
            ),
            damping_ratio: PerJoint::All(
                ratio.map_err(|message| ControlError::value("damping_ratio", message))?,
            ),
        })
    }
}

impl JointTrackingParameters {
    /// Creates a task of all joints.
    #[must_use]
    pub fn new(reference: JointReference, gains: JointGains) -> Self {
        let (weight, when_limited) = (equal_weights(), WhenLimited::LeastSquares);
        Self { joints: None, reference, gains, weight, when_limited }
    }
}

impl JointPostureParameters {
    /// Creates a task that holds the start posture.
    #[must_use]
    pub fn new(gains: JointGains) -> Self {
        let JointGains { frequency_rad_per_s, damping_ratio } = gains;
        Self { posture_rad: BTreeMap::new(), frequency_rad_per_s, damping_ratio, weight: equal_weights() }
    }
}

impl JointDampingParameters {
    /// Creates a task with one damping for all joints, Nms/rad or Ns/m.
    ///
    /// # Errors
    /// A negative damping.
    pub fn new(damping_nms_per_rad: f64) -> Result<Self, ControlError> {
        let damping = NonNegative::try_from(damping_nms_per_rad);
        let damping = damping.map_err(|message| ControlError::value("damping_nms_per_rad", message))?;
        Ok(Self { damping_nms_per_rad: PerJoint::All(damping) })
    }
}

/// Stiffness (1/s²) and damping (1/s) of each joint.
#[derive(Clone, Debug)]
pub(crate) struct JointFeedback {
    pub stiffness: Vec<f64>,
    pub damping: Vec<f64>,
}

impl JointFeedback {
    pub(crate) fn new(
        frequency: &PerJoint<Positive>,
        ratio: &PerJoint<NonNegative>,
        model: &Model,
        key: &str,
    ) -> Result<Self, ControlError> {
        let omega = frequency.resolve(model, &format!("{key}.frequency_rad_per_s"))?;
        let zeta = ratio.resolve(model, &format!("{key}.damping_ratio"))?;
        Ok(Self {
            stiffness: omega.iter().map(|w| w.get() * w.get()).collect(),
            damping: omega.iter().zip(&zeta).map(|(w, z)| 2.0 * z.get() * w.get()).collect(),
        })
    }
}
