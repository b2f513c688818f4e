//! Pushes at given times: `[environment.NAME.pushes]`.

use nalgebra::Vector3;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Pushes, each a half sine in time.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PushesParameters {
    /// Name of the frame that is pushed.
    pub frame: String,
    /// List of pushes.
    pub push: Vec<PushParameters>,
}

/// Single push, a half sine in time.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PushParameters {
    /// Beginning, in s after the controller's start.
    pub at_s: NonNegative,
    /// Duration, s.
    pub duration_s: Positive,
    /// Peak force in world axes, N.
    #[serde(deserialize_with = "exactly")]
    pub force_n: [f64; 3],
}

impl PushParameters {
    pub(super) fn force(&self, t: f64) -> Vector3<f64> {
        let u = (t - self.at_s.get()) / self.duration_s.get();
        let share = if (0.0..=1.0).contains(&u) { (TAU / 2.0 * u).sin() } else { 0.0 };
        Vector3::from(self.force_n) * share
    }
}
