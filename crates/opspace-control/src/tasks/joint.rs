//! The joint-space tasks: tracking, posture and damping. Each takes what freedom the tasks above it leave.
//!
//! ```text
//! tracking  τ = Nᵀ M (q̈_d + 2ζω (q̇_d − q̇) + ω² (q_d − q))
//! posture   τ = Nᵀ M (ω² (q_0 − q) − 2ζω q̇)
//! damping   τ = −Nᵀ D q̇
//! ```

use crate::error::{ControlError, Reason};
use crate::hierarchy::products::multiply;
use crate::measurement::Measurement;
use crate::per_joint::{PerJoint, indices};
use crate::references::joint_reference::{JointReference, JointTarget, JointTrajectory};
use nalgebra::{DVector, Matrix6xX, Vector6};
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::{Row, Signal};
use opspace_model::{Data, Inversion, Model};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The joints follow a reference.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointTrackingParameters {
    /// The joints that belong to the task, six at most: tasks below it may use the others. All of them if absent, and
    /// the task must then be the last.
    #[serde(default)]
    pub joints: Option<Vec<String>>,
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
    Tracking(Box<Tracking>),
    Posture(Posture),
    Damping(Damping),
}

impl JointTask {
    /// Begins where the robot is.
    pub(crate) fn start(&mut self, measurement: &Measurement) {
        match self {
            Self::Tracking(task) => task.start(measurement),
            Self::Posture(task) => task.start(&measurement.q),
            Self::Damping(_) => {}
        }
    }

    /// Goes on from where the joint task of another stack stands.
    pub(crate) fn take_over(&mut self, before: &mut Self, measurement: &Measurement) {
        match (self, before) {
            (Self::Tracking(task), Self::Tracking(before)) => task.take_over(before, measurement),
            (Self::Posture(task), Self::Posture(before)) => task.take_over(before),
            (task, _) => task.start(measurement),
        }
    }

    pub(crate) fn name(&self) -> &str {
        match self {
            Self::Tracking(task) => &task.name,
            Self::Posture(task) => &task.name,
            Self::Damping(task) => &task.name,
        }
    }

    /// The joint accelerations and the torques that cause them, before projection (n).
    pub(crate) fn update(&mut self, data: &Data, time_s: f64, acceleration: &mut [f64], torque: &mut [f64]) {
        match self {
            Self::Damping(task) => {
                for ((t, d), dq) in torque.iter_mut().zip(&task.damping).zip(&data.dq) {
                    *t = -*d * dq;
                }
                acceleration.copy_from_slice(torque);
                data.mass_matrix_factor.solve(acceleration);
                return;
            }
            Self::Tracking(task) => {
                task.observe(data.q.as_slice(), time_s);
                task.acceleration(data, acceleration);
            }
            Self::Posture(task) => task.acceleration(data, acceleration),
        }
        multiply(&data.mass_matrix, acceleration, torque);
    }

    pub(crate) fn signals(&self) -> Vec<Signal> {
        match self {
            Self::Tracking(task) => task.signals(),
            Self::Posture(_) | Self::Damping(_) => Vec::new(),
        }
    }

    /// Whether it has signals.
    pub(crate) fn is_sampled(&self) -> bool {
        matches!(self, Self::Tracking(_))
    }

    pub(crate) fn sample(&self, row: &mut Row<'_>) {
        if let Self::Tracking(task) = self {
            task.sample(row);
        }
    }
}

/// See [`JointTrackingParameters`].
#[derive(Clone, Debug)]
pub(crate) struct Tracking {
    name: String,
    joint_names: Vec<String>,
    parameters: JointReference,
    trajectory: JointTrajectory,
    /// When the trajectory began, s, and where the run began.
    start_s: f64,
    home: DVector<f64>,
    gains: Gains,
    pub reference: DVector<f64>,
    pub reference_velocity: DVector<f64>,
    reference_acceleration: DVector<f64>,
    error: DVector<f64>,
    /// Where the file's reference is, whether or not the joints have joined it.
    path: DVector<f64>,
    path_velocity: DVector<f64>,
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
            joint_names: model.joints().iter().map(|j| j.name.clone()).collect(),
            parameters: parameters.reference.clone(),
            trajectory: JointTrajectory::new(&parameters.reference, model, &format!("{key}.reference"))?,
            start_s: 0.0,
            home: zero.clone(),
            gains: Gains::new(frequency_rad_per_s, damping_ratio, model, &format!("{key}.gains"))?,
            reference: zero.clone(),
            reference_velocity: zero.clone(),
            reference_acceleration: zero.clone(),
            error: zero.clone(),
            path: zero.clone(),
            path_velocity: zero,
        })
    }

    fn start(&mut self, measurement: &Measurement) {
        self.home.copy_from(&measurement.q);
        self.reference.copy_from(&measurement.q);
        self.reference_velocity.fill(0.0);
        self.reference_acceleration.fill(0.0);
        self.begin(measurement.q.as_slice(), measurement.time_s);
    }

    /// Joins the reference from `q` (n), at rest; sets out for a goal anew.
    pub(crate) fn resume(&mut self, q: &[f64], time_s: f64) {
        if self.trajectory.is_online() {
            self.reference.copy_from_slice(q);
            self.reference_velocity.fill(0.0);
            self.reference_acceleration.fill(0.0);
            self.begin(q, time_s);
        } else {
            self.trajectory.join(time_s - self.start_s, q);
            self.observe(q, time_s);
        }
    }

    /// The same reference goes on; another one begins where that one was.
    fn take_over(&mut self, before: &mut Self, measurement: &Measurement) {
        before.observe(measurement.q.as_slice(), measurement.time_s);
        self.home.copy_from(&before.home);
        if self.parameters == before.parameters {
            std::mem::swap(&mut self.trajectory, &mut before.trajectory);
            self.start_s = before.start_s;
            self.observe(measurement.q.as_slice(), measurement.time_s);
            return;
        }
        self.reference.copy_from(&before.reference);
        self.reference_velocity.copy_from(&before.reference_velocity);
        self.reference_acceleration.copy_from(&before.reference_acceleration);
        self.begin(measurement.q.as_slice(), measurement.time_s);
    }

    /// The trajectory begins at the reference as it stands.
    fn begin(&mut self, q: &[f64], time_s: f64) {
        self.start_s = time_s;
        let from = JointTarget {
            position: self.reference.as_slice(),
            velocity: self.reference_velocity.as_slice(),
            acceleration: self.reference_acceleration.as_slice(),
        };
        self.trajectory.start(self.home.as_slice(), &from);
        self.observe(q, time_s);
    }

    /// Takes in where the joints are and where they should be.
    pub(crate) fn observe(&mut self, q: &[f64], time_s: f64) {
        let time_s = time_s - self.start_s;
        for (i, q) in q.iter().enumerate() {
            let [position, velocity, acceleration] = self.trajectory.reference_at(i, time_s);
            let away = self.trajectory.away(i, time_s);
            self.path[i] = position;
            self.path_velocity[i] = velocity;
            self.reference[i] = position + away[0];
            self.reference_velocity[i] = velocity + away[1];
            self.reference_acceleration[i] = acceleration + away[2];
            self.error[i] = self.reference[i] - q;
        }
    }

    fn acceleration(&self, data: &Data, out: &mut [f64]) {
        for (i, a) in out.iter_mut().enumerate() {
            *a = self.wanted(data, i);
        }
    }

    /// q̈* of a joint, rad/s².
    fn wanted(&self, data: &Data, i: usize) -> f64 {
        self.reference_acceleration[i]
            + self.gains.damping[i] * (self.reference_velocity[i] - data.dq[i])
            + self.gains.stiffness[i] * self.error[i]
    }

    fn signals(&self) -> Vec<Signal> {
        vec![
            Signal::new(format!("{}.reference", self.name), "rad", &self.joint_names),
            Signal::new(format!("{}.reference_velocity", self.name), "rad/s", &self.joint_names),
            Signal::new(format!("{}.error", self.name), "rad", &self.joint_names),
        ]
    }

    fn sample(&self, row: &mut Row<'_>) {
        row.put(self.path.as_slice());
        row.put(self.path_velocity.as_slice());
        row.put(self.error.as_slice());
    }
}

/// Below which share of their typical mobility some joints' directions are damped, once tasks above have taken the rest.
pub const JOINTS_SINGULARITY_THRESHOLD: f64 = 1e-3;

/// Some joints that follow a reference, as rows of a task that may stand above others.
#[derive(Clone, Debug)]
pub(crate) struct SelectedJoints {
    tracking: Tracking,
    joints: Vec<usize>,
    jacobian: Matrix6xX<f64>,
}

impl SelectedJoints {
    /// A joint alone is never singular: only what tasks above have taken is.
    pub(crate) const INVERSION: Inversion = Inversion::Damped(JOINTS_SINGULARITY_THRESHOLD);

    /// Of the joints named, in that order.
    pub(crate) fn new(
        name: &str,
        names: &[String],
        parameters: &JointTrackingParameters,
        model: &Model,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.joint-tracking.joints");
        if names.is_empty() {
            return Err(ControlError::new(key, Reason::JointList));
        }
        let mut joints = Vec::with_capacity(names.len());
        for joint in names {
            let index = model.joint(joint).map_err(|unknown| ControlError::new(&key, unknown))?;
            if joints.contains(&index) {
                return Err(ControlError::new(&key, Reason::JointList));
            }
            joints.push(index);
        }
        if joints.len() > 6 {
            return Err(ControlError::new(&key, Reason::TooManyJoints { joints: joints.len(), most: 6 }));
        }
        let mut jacobian = Matrix6xX::zeros(model.n());
        for (row, &joint) in joints.iter().enumerate() {
            jacobian[(row, joint)] = 1.0;
        }
        Ok(Self { tracking: Tracking::new(name, parameters, model)?, joints, jacobian })
    }

    pub(crate) fn name(&self) -> &str {
        &self.tracking.name
    }

    /// By index, in the order of the rows.
    pub(crate) fn joints(&self) -> &[usize] {
        &self.joints
    }

    /// One row a joint.
    pub(crate) fn jacobian(&self) -> &Matrix6xX<f64> {
        &self.jacobian
    }

    pub(crate) fn start(&mut self, measurement: &Measurement) {
        self.tracking.start(measurement);
    }

    pub(crate) fn resume(&mut self, q: &[f64], time_s: f64) {
        self.tracking.resume(q, time_s);
    }

    pub(crate) fn take_over(&mut self, before: &mut Self, measurement: &Measurement) {
        self.tracking.take_over(&mut before.tracking, measurement);
    }

    pub(crate) fn observe(&mut self, q: &[f64], time_s: f64) {
        self.tracking.observe(q, time_s);
    }

    /// q̈* of the rows, rad/s².
    pub(crate) fn acceleration(&self, data: &Data) -> Vector6<f64> {
        self.rows(|joint| self.tracking.wanted(data, joint))
    }

    /// q̇* of the rows for joints at `q`, with their errors worked off at `gain` (1/s), rad/s.
    pub(crate) fn velocity(&self, q: &DVector<f64>, gain: f64) -> Vector6<f64> {
        let tracking = &self.tracking;
        self.rows(|i| tracking.reference_velocity[i] + gain * (tracking.reference[i] - q[i]))
    }

    fn rows(&self, of: impl Fn(usize) -> f64) -> Vector6<f64> {
        let mut rows = Vector6::zeros();
        for (row, &joint) in rows.iter_mut().zip(&self.joints) {
            *row = of(joint);
        }
        rows
    }

    pub(crate) fn signals(&self) -> Vec<Signal> {
        self.tracking.signals()
    }

    pub(crate) fn sample(&self, row: &mut Row<'_>) {
        self.tracking.sample(row);
    }
}

/// See [`JointPostureParameters`].
#[derive(Clone, Debug)]
pub(crate) struct Posture {
    name: String,
    fixed: Vec<(usize, f64)>,
    gains: Gains,
    start: DVector<f64>,
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
            name: name.to_owned(),
            fixed: fixed.into_iter().map(|(joint, &value)| (joint, value)).collect(),
            gains: Gains::new(&parameters.frequency_rad_per_s, &parameters.damping_ratio, model, &key)?,
            start: DVector::zeros(model.n()),
            posture: DVector::zeros(model.n()),
        })
    }

    /// Where the run began stays the posture of joints that aren't named.
    fn take_over(&mut self, before: &Self) {
        self.posture.copy_from(&before.start);
        self.start.copy_from(&before.start);
        self.name_posture();
    }

    fn start(&mut self, q: &DVector<f64>) {
        self.posture.copy_from(q);
        self.start.copy_from(q);
        self.name_posture();
    }

    fn name_posture(&mut self) {
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

/// See [`JointDampingParameters`].
#[derive(Clone, Debug)]
pub(crate) struct Damping {
    name: String,
    /// Nms/rad.
    damping: Vec<f64>,
}

impl Damping {
    pub(crate) fn new(
        name: &str,
        parameters: &JointDampingParameters,
        model: &Model,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.joint-damping.damping_nms_per_rad");
        let damping = parameters.damping_nms_per_rad.resolve(model, &key)?;
        Ok(Self { name: name.to_owned(), damping: damping.into_iter().map(NonNegative::get).collect() })
    }
}
