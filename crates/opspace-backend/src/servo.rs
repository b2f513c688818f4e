//! The position servos of drives, as they are known: what a transformer inverts.

use opspace_control::quantity::Positive;
use schemars::JsonSchema;
use serde::Deserialize;

/// A joint's position servo.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ServoParameters {
    /// A proportional position loop around a proportional velocity loop.
    Cascaded(CascadedServo),
}

/// Equation (9) of the paper: `τ = kv [kp (q_desired − q) − q̇]`.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CascadedServo {
    /// Gain of the outer position loop, 1/s.
    pub kp_per_s: Positive,
    /// Gain of the inner velocity loop, Nms/rad (Ns/m).
    pub kv_nms_per_rad: Positive,
    /// Cut-off of the servo's own low-pass on its finite-difference velocity, Hz.
    pub velocity_filter_hz: Positive,
}

impl ServoParameters {
    /// The gains of the cascade that the servo is or amounts to.
    #[must_use]
    pub fn cascade(&self) -> &CascadedServo {
        match self {
            Self::Cascaded(servo) => servo,
        }
    }
}
