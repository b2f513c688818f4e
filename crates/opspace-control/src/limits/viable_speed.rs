//! Highest speeds of joints towards their position limits.

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

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: the highest acceleration that the bounds of a control cycle allow with zero, at the highest speed and beside
    /// it.
    #[test]
    fn joint_need_not_brake_at_its_highest_speed() {
        let (h, end, velocity) = (0.02, 1.0, 3.0);
        let limits = JointLimits {
            lower: vec![-end],
            upper: vec![end],
            velocity: vec![velocity],
            ..JointLimits::none(1)
        };
        for braking in [0.1, 1.0, 10.0, 100.0] {
            let bounds = Bounds::with_braking(limits.clone(), vec![braking], 1e-3, h);
            let speeds = ViableSpeeds { bounds };
            for upwards in [true, false] {
                let place = |left: f64| if upwards { end - left } else { left - end };
                assert_eq!(speeds.highest(0, place(-0.1), upwards), 0.0);
                for left in [1e-3, 1e-2, 0.1, 0.5, 1.5] {
                    let v = speeds.highest(0, place(left), upwards);
                    let most = |v: f64| speeds.bounds.highest_acceleration(0, place(left), v, upwards);
                    assert!(v > 0.0 && v <= velocity);
                    assert!(
                        v == velocity || most(v).abs() < 1e-9,
                        "{braking} rad/s^2, {left} rad before the limit"
                    );
                    assert!(most(0.99 * v) > 0.0 && most(1.01 * v) < 0.0, "{braking} rad/s^2, {left} rad");
                }
            }
        }
    }
}
