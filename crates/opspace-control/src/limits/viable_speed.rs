//! Highest speeds of joints towards their position limits.
//!
//! ```text
//! v(x − q) = √((2 b h)² + 2 b (x − q)) − 2 b h        at most the speed limit
//! ```
//!
//! x is the position limit, b the braking acceleration, h the [horizon](crate::limits::horizon).

use crate::limits::bounds::Bounds;
use crate::limits::joint_limits::{JointLimits, LimitParameters};
use opspace_model::Model;

/// Highest speeds of joints within the limits that a controller enforces, for motions that are planned ahead. With v(q) in
/// the direction of q̇, the limits of position and speed do not hold back a joint that keeps q̇ + h q̈ ≤ v(q), where the
/// torque suffices.
#[derive(Clone, Debug)]
pub struct ViableSpeeds {
    bounds: Bounds,
}

impl ViableSpeeds {
    /// Computes the speeds for a controller with these parameters and the control period `period_s` (s).
    #[must_use]
    pub fn new(model: &Model, limits: &JointLimits, parameters: &LimitParameters, period_s: f64) -> Self {
        let limits = limits.clone().narrowed(parameters);
        Self { bounds: Bounds::new(model, limits, period_s, parameters.horizon_s(period_s)) }
    }

    /// Horizon h, s.
    #[must_use]
    pub fn horizon_s(&self) -> f64 {
        self.bounds.horizon_s()
    }

    /// Highest speed v of the joint with the number `joint` at the position `q` (rad or m) towards its upper limit, or
    /// towards its lower limit if `upwards` is false, rad/s or m/s: the one at which the joint need not brake yet. 0 at the
    /// limit and beyond it.
    ///
    /// # Panics
    /// If there is no such joint.
    #[must_use]
    pub fn highest(&self, joint: usize, q: f64, upwards: bool) -> f64 {
        self.bounds.viable_speed(joint, q, upwards)
    }
}
