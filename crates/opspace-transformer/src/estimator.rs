//! Estimation of joint velocity from positions: finite difference at the interface rate and a first-order low-pass.
//!
//! This is the paper's estimate (§III: "estimated with the available data and then filtered with a low
//! pass filter").

use crate::motion_estimator::{MotionEstimator, MotionGains};
use nalgebra::DVector;
use opspace_backend::low_pass;
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Estimate of joint velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum VelocitySource {
    /// Prediction of the arm and its drives under the command, corrected by the encoders.
    Observer,
    /// Filtered difference of positions.
    Filter,
}

/// Estimation of joint velocity.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorParameters {
    /// Estimate of the velocities that the controller uses: `observer` or `filter`. By default robots that take
    /// velocities, torque robots whose gears are declared rigid, and the transformers `emulation` and `interpolating`, use
    /// the observer, and all others the filter, as the paper does. A torque robot that measures velocities uses these.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "depends on the robot and the transformer")))]
    pub velocity: Option<VelocitySource>,
    /// Cut-off frequency of the low-pass filter on the finite difference, Hz.
    pub velocity_filter_hz: Positive,
    /// Rms noise of measured positions at the joints, rad (m), for `extrapolation` where drives limit the acceleration of
    /// setpoints.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the encoders' resolution")))]
    pub position_noise_rad: Option<Positive>,
}

impl Default for EstimatorParameters {
    /// Returns the cut-off of the paper's experiments, 150 Hz.
    fn default() -> Self {
        Self { velocity: None, velocity_filter_hz: Positive::literal(150.0), position_noise_rad: None }
    }
}

/// Velocity estimator of n joints: `w += a ((y − y₋)/T − w)` with `a = 1 − exp(−2π f T)`. T is the time since the last
/// sample, several periods if samples were missed.
#[derive(Clone, Debug)]
pub struct VelocityEstimator {
    joints: Vec<MotionEstimator>,
    velocity: DVector<f64>,
}

impl VelocityEstimator {
    /// Returns an estimator with zero velocity; `period_s` is the time between two positions, s.
    #[must_use]
    pub fn new(n: usize, parameters: &EstimatorParameters, period_s: f64) -> Self {
        let gain = low_pass::gain(parameters.velocity_filter_hz.get(), period_s);
        let joint = MotionEstimator::new(MotionGains::Difference { gain }, period_s);
        Self { joints: vec![joint; n], velocity: DVector::zeros(n) }
    }

    /// Updates the estimate with new positions `q` (n; rad or m) and returns the velocity (n; rad/s or m/s), which is 0
    /// after the first positions.
    pub fn update(&mut self, q: &[f64]) -> &[f64] {
        self.update_after(1, q)
    }

    /// Same as [`update`](Self::update), for positions measured `periods` periods after the last ones.
    pub fn update_after(&mut self, periods: u64, q: &[f64]) -> &[f64] {
        for ((joint, velocity), &q) in self.joints.iter_mut().zip(&mut self.velocity).zip(q) {
            joint.update(periods, q);
            *velocity = joint.velocity;
        }
        self.velocity.as_slice()
    }

    /// Resets the estimator: the next positions are the first.
    pub fn reset(&mut self) {
        self.joints.iter_mut().for_each(MotionEstimator::reset);
        self.velocity.fill(0.0);
    }
}
