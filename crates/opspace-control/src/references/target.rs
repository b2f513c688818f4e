//! Target of a frame: pose, velocity and acceleration.
//!
//! ```text
//! (x_d, R_d)        (ẋ_d, ω_d)        (ẍ_d, ω̇_d)
//! ```

use opspace_model::{Motion, Placement};

/// Duration of the blend of a target into its reference, s. A distance of 0.1 m then needs at most a speed of 0.19 m/s
/// and an acceleration of 0.6 m/s².
pub const BLEND_S: f64 = 1.0;

/// Target of a frame, in world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Pose in the world.
    pub placement: Placement,
    /// Velocity of the frame's origin (m/s) and angular velocity of the frame (rad/s).
    pub velocity: Motion,
    /// Time derivative of `velocity` (m/s², rad/s²).
    pub acceleration: Motion,
}

impl Target {
    /// Returns a target at rest at a pose.
    #[must_use]
    pub fn at_rest(placement: Placement) -> Self {
        Self { placement, velocity: Motion::zero(), acceleration: Motion::zero() }
    }
}
