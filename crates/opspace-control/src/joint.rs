//! The joint-space tasks: tracking, posture and damping. Each takes what freedom the tasks above it leave.
//!
//! ```text
//! tracking  τ = Nᵀ M (q̈_d + 2ζω (q̇_d − q̇) + ω² (q_d − q))
//! posture   τ = Nᵀ M (ω² (q_0 − q) − 2ζω q̇)
//! damping   τ = −Nᵀ D q̇
//! ```

use crate::error::ControlError;
use crate::joint_reference::{JointReference, JointTrajectory};
use crate::per_joint::{PerJoint, indices};
use crate::quantity::{NonNegative, Positive};
use crate::signal::{Row, Signal};
use nalgebra::DVector;
use opspace_model::{Data, Model};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The joints follow a reference.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointTrackingParameters {
    /// Where the joints should be.
    pub reference: JointReference,
    /// How stiffly they follow.
    pub gains: JointGains,
}

/// How a joint follows: as a unit inertia on a spring and a damper, whatever the arm's inertia.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointGains {
    /// Natural frequency ω of the error, rad/s: the stiffness is ω² (1/s²).
    pub frequency_rad_per_s: PerJoint<Positive>,
    /// Damping ratio ζ of the error: the damping is 2ζω (1/s).
    pub damping_ratio: PerJoint<NonNegative>,
}

/// The joints are drawn to a posture.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointPostureParameters {
    /// The posture by joint names, rad (m for a prismatic joint); the start posture for joints that are
    /// not named.
    #[serde(default)]
    pub posture_rad: BTreeMap<String, f64>,
    /// Natural frequency ω of the error, rad/s: the stiffness is ω² (1/s²).
    pub frequency_rad_per_s: PerJoint<Positive>,
    /// Damping ratio ζ of the error: the damping is 2ζω (1/s).
    pub damping_ratio: PerJoint<NonNegative>,
}

/// The joints are braked in proportion to their speed.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointDampingParameters {
    /// Damping, Nms/rad (Ns/m for a prismatic joint); may be 0.
    pub damping_nms_per_rad: PerJoint<NonNegative>,
}

/// Stiffness (1/s²) and damping (1/s) of each joint.
#[derive(Clone, Debug)]
struct Gains {
    stiffness: Vec<f64>,
    damping: Vec<f64>,
}

impl Gains {
    fn new(
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

/// A joint-space task of one robot, and what it saw last.
#[derive(Clone, Debug)]
pub(crate) enum JointTask {
    Tracking(Tracking),
    Posture(Posture),
    Damping(Vec<f64>),
}

impl JointTask {
    /// Takes `q` (n) as the start.
    pub(crate) fn start(&mut self, q: &DVector<f64>) {
        match self {
            Self::Tracking(task) => {
                task.trajectory.start(q);
                task.observe(q, 0.0);
            }
            Self::Posture(task) => task.start(q),
            Self::Damping(_) => {}
        }
    }

    /// The torque before projection (n), into `torque`; `scratch` (n) is overwritten.
    pub(crate) fn torque(&mut self, data: &Data, time_s: f64, scratch: &mut [f64], torque: &mut [f64]) {
        match self {
            Self::Damping(damping) => {
                for ((t, d), dq) in torque.iter_mut().zip(damping).zip(&data.dq) {
                    *t = -*d * dq;
                }
                return;
            }
            Self::Tracking(task) => {
                task.observe(&data.q, time_s);
                task.acceleration(data, scratch);
            }
            Self::Posture(task) => task.acceleration(data, scratch),
        }
        for (i, t) in torque.iter_mut().enumerate() {
            *t = scratch.iter().enumerate().map(|(k, a)| data.mass_matrix[(i, k)] * a).sum();
        }
    }

    pub(crate) fn signals(&self, model: &Model) -> Vec<Signal> {
        match self {
            Self::Tracking(task) => task.signals(model),
            Self::Posture(_) | Self::Damping(_) => Vec::new(),
        }
    }

    pub(crate) fn sample(&self, row: &mut Row<'_>) {
        if let Self::Tracking(task) = self {
            row.put(task.reference.as_slice());
            row.put(task.reference_velocity.as_slice());
            row.put(task.error.as_slice());
        }
    }
}

/// See [`JointTrackingParameters`].
#[derive(Clone, Debug)]
pub(crate) struct Tracking {
    name: String,
    trajectory: JointTrajectory,
    gains: Gains,
    pub reference: DVector<f64>,
    pub reference_velocity: DVector<f64>,
    reference_acceleration: DVector<f64>,
    error: DVector<f64>,
}

impl Tracking {
    pub(crate) fn new(
        name: &str,
        parameters: &JointTrackingParameters,
        model: &Model,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.joint-tracking");
        let JointGains { frequency_rad_per_s, damping_ratio } = &parameters.gains;
        let zero = DVector::zeros(model.n());
        Ok(Self {
            name: name.to_owned(),
            trajectory: JointTrajectory::new(&parameters.reference, model, &format!("{key}.reference"))?,
            gains: Gains::new(frequency_rad_per_s, damping_ratio, model, &format!("{key}.gains"))?,
            reference: zero.clone(),
            reference_velocity: zero.clone(),
            reference_acceleration: zero.clone(),
            error: zero,
        })
    }

    /// Takes in where the joints are and where they should be.
    pub(crate) fn observe(&mut self, q: &DVector<f64>, time_s: f64) {
        for i in 0..q.len() {
            let [reference, velocity, acceleration] = self.trajectory.at(i, time_s);
            self.reference[i] = reference;
            self.reference_velocity[i] = velocity;
            self.reference_acceleration[i] = acceleration;
            self.error[i] = reference - q[i];
        }
    }

    fn acceleration(&self, data: &Data, out: &mut [f64]) {
        for (i, a) in out.iter_mut().enumerate() {
            *a = self.reference_acceleration[i]
                + self.gains.damping[i] * (self.reference_velocity[i] - data.dq[i])
                + self.gains.stiffness[i] * self.error[i];
        }
    }

    fn signals(&self, model: &Model) -> Vec<Signal> {
        let joints: Vec<&str> = model.joints().iter().map(|j| j.name.as_str()).collect();
        vec![
            Signal::new(format!("{}.reference", self.name), "rad", &joints),
            Signal::new(format!("{}.reference_velocity", self.name), "rad/s", &joints),
            Signal::new(format!("{}.error", self.name), "rad", &joints),
        ]
    }
}

/// See [`JointPostureParameters`].
#[derive(Clone, Debug)]
pub(crate) struct Posture {
    fixed: Vec<(usize, f64)>,
    gains: Gains,
    pub posture: DVector<f64>,
}

impl Posture {
    pub(crate) fn new(
        name: &str,
        parameters: &JointPostureParameters,
        model: &Model,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.joint-posture");
        let fixed = indices(model, &format!("{key}.posture_rad"), &parameters.posture_rad)?;
        Ok(Self {
            fixed: fixed.into_iter().map(|(joint, &value)| (joint, value)).collect(),
            gains: Gains::new(&parameters.frequency_rad_per_s, &parameters.damping_ratio, model, &key)?,
            posture: DVector::zeros(model.n()),
        })
    }

    fn start(&mut self, q: &DVector<f64>) {
        self.posture.copy_from(q);
        for &(joint, value) in &self.fixed {
            self.posture[joint] = value;
        }
    }

    fn acceleration(&self, data: &Data, out: &mut [f64]) {
        for (i, a) in out.iter_mut().enumerate() {
            *a = self.gains.stiffness[i] * (self.posture[i] - data.q[i]) - self.gains.damping[i] * data.dq[i];
        }
    }
}

/// The damping of each joint (Nms/rad).
pub(crate) fn damping(
    name: &str,
    parameters: &JointDampingParameters,
    model: &Model,
) -> Result<Vec<f64>, ControlError> {
    let key = format!("task.{name}.joint-damping.damping_nms_per_rad");
    let damping = parameters.damping_nms_per_rad.resolve(model, &key)?;
    Ok(damping.into_iter().map(NonNegative::get).collect())
}
