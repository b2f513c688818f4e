//! Pushes at given times: `[environment.NAME.pushes]`.

use nalgebra::Vector3;
use opspace_backend::quantity::{NonNegative, Positive, exactly};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::PI;
use std::num::NonZeroU16;

/// Pushes, each with a shape in time.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PushesParameters {
    /// Name of the frame that is pushed.
    pub frame: String,
    /// List of pushes.
    pub push: Vec<PushParameters>,
}

/// Single push.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PushParameters {
    /// Beginning, in s after the controller's start.
    pub at_s: NonNegative,
    /// Duration, s; of rise and fall together with all that is between.
    pub duration_s: Positive,
    /// Course of the force in time.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "`\"half-sine\"`")))]
    pub shape: PushShape,
    /// Peak force in world axes, N.
    #[serde(deserialize_with = "exactly")]
    pub force_n: [f64; 3],
}

/// Course of the force of a push, from zero to the peak and back to zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum PushShape {
    /// Half a period of a sine.
    #[default]
    HalfSine,
    /// The peak during the whole duration.
    Step,
    /// Rises during the first half of the duration, and falls during the second.
    Ramp,
    /// Rises during the first quarter of the duration, holds the peak, and falls during the last quarter.
    Hold,
    /// Rises in equal steps to the peak, and falls in the same steps; all levels last equally long.
    Staircase(Staircase),
}

/// Steps of a push in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Staircase {
    /// Number of steps from zero to the peak.
    pub steps: NonZeroU16,
}

impl PushParameters {
    pub(super) fn force(&self, t: f64) -> Vector3<f64> {
        let u = (t - self.at_s.get()) / self.duration_s.get();
        let share = if (0.0..=1.0).contains(&u) { self.shape.share(u) } else { 0.0 };
        Vector3::from(self.force_n) * share
    }
}

impl PushShape {
    /// Force relative to the peak at a fraction of the duration, 0 to 1.
    fn share(self, u: f64) -> f64 {
        // Distance from the nearer end, relative to half the duration.
        let inside = 2.0 * u.min(1.0 - u);
        match self {
            Self::HalfSine => (PI * u).sin(),
            Self::Step => 1.0,
            Self::Ramp => inside,
            Self::Hold => (2.0 * inside).min(1.0),
            Self::Staircase(Staircase { steps }) => {
                let steps = f64::from(steps.get());
                // Each step up and down is a level, and the peak is one of them.
                let level = (u * (2.0 * steps - 1.0)).floor().min(2.0 * steps - 2.0);
                (steps - (level + 1.0 - steps).abs()) / steps
            }
        }
    }
}
