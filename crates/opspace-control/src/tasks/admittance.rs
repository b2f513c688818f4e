//! Admittance: along a compliant or force axis, the commanded frame moves with the force error.
//!
//! ```text
//! ẋ = (f − f_target)/B       |ẋ| ≤ speed limit       |x − x_measured| ≤ lead limit
//! ```
//!
//! f is the sensed force ON the robot, x the commanded position along the axis and B the admittance damping
//! `admittance_ns_per_m`. [Inverse kinematics](crate::ik) integrates ẋ into the setpoints of the position servos; the torque
//! controller does not use it. The same holds for moments, with `admittance_nms_per_rad`. Without contact, the frame
//! approaches with |f_target|/B. On a wall of stiffness K, an ideal robot has the pole −K/B, and in control cycles of T the
//! pole 1 − K T/B: it is stable only if K T/B < 2, and the lag of real servos leaves less (Whitney, *Force feedback control of
//! manipulator fine motions*, 1977).

use crate::error::{ControlError, Reason};
use crate::tasks::axes::{AXIS_NAMES, PerAxis};
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Limits of the commanded motion along axes with an admittance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct AdmittanceLimits {
    /// Highest speed along an axis, m/s; unlimited if absent. Without contact, the hand approaches at most this fast.
    pub speed_m_per_s: Option<Positive>,
    /// Highest speed about an axis, rad/s; unlimited if absent.
    pub speed_rad_per_s: Option<Positive>,
    /// Largest distance of the commanded position from the measured one along an axis, m. It bounds the force that builds
    /// up while the robot is blocked to this distance times the stiffness of its servos.
    #[cfg_attr(feature = "schema", schemars(extend("default" = LEAD_M)))]
    pub lead_m: Option<Positive>,
    /// Largest angle of the commanded orientation from the measured one about an axis, rad.
    #[cfg_attr(feature = "schema", schemars(extend("default" = LEAD_RAD)))]
    pub lead_rad: Option<Positive>,
}

/// Default of [`AdmittanceLimits::lead_m`], m.
const LEAD_M: f64 = 0.02;

/// Default of [`AdmittanceLimits::lead_rad`], rad.
const LEAD_RAD: f64 = 0.1;

/// Admittance of the axes of a task.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Admittance {
    /// Damping B, Ns/m or Nms/rad; `None` on axes without an admittance.
    damping: [Option<f64>; 6],
    /// Speed limits, m/s and rad/s; infinite if there is none.
    speed: [f64; 2],
    /// Lead limits, m and rad.
    lead: [f64; 2],
    period_s: f64,
}

impl Admittance {
    /// Creates the admittance of the axes `held` that are compliant or in force control, from the damping along and about
    /// the axes. `key` is the path of the force feedback in the file. `None` if no axis has an admittance.
    pub(crate) fn new(
        [linear, angular]: [&Option<PerAxis<Positive>>; 2],
        limits: &AdmittanceLimits,
        held: [bool; 6],
        period_s: f64,
        key: &str,
    ) -> Result<Option<Self>, ControlError> {
        let mut damping = [None; 6];
        for (place, values, kind) in
            [("admittance_ns_per_m", linear, 0..3), ("admittance_nms_per_rad", angular, 3..6)]
        {
            let Some(values) = values else { continue };
            if let Some(axis) = values.named().find(|axis| !kind.contains(axis) || !held[*axis]) {
                let reason = Reason::AdmittanceAxis { axis: AXIS_NAMES[axis] };
                return Err(ControlError::new(format!("{key}.{place}"), reason));
            }
            for axis in kind {
                damping[axis] = values.get(axis).map(Positive::get);
            }
        }
        if damping == [None; 6] {
            if *limits != AdmittanceLimits::default() {
                let message = "no axis has an admittance: give `admittance_ns_per_m` or `admittance_nms_per_rad`, or remove \
                               the limits"
                    .to_owned();
                return Err(ControlError::value(&format!("{key}.admittance_limits"), message));
            }
            return Ok(None);
        }
        let or = |limit: Option<Positive>, default| limit.map_or(default, Positive::get);
        Ok(Some(Self {
            damping,
            speed: [or(limits.speed_m_per_s, f64::INFINITY), or(limits.speed_rad_per_s, f64::INFINITY)],
            lead: [or(limits.lead_m, LEAD_M), or(limits.lead_rad, LEAD_RAD)],
            period_s,
        }))
    }

    /// Returns true if an axis has an admittance.
    pub(crate) fn is_given(&self, axis: usize) -> bool {
        self.damping[axis].is_some()
    }

    /// Returns the commanded velocity along an axis (m/s or rad/s) for the force error f − f_target (N or Nm), while the
    /// command leads the measurement by `lead` (m or rad). An error that is not finite stops the axis for this cycle.
    pub(crate) fn velocity(&self, axis: usize, error: f64, lead: f64) -> f64 {
        self.damping[axis].map_or(0.0, |damping| self.bounded(axis, error / damping, lead))
    }

    /// Returns a velocity within the limits of speed and lead.
    pub(crate) fn bounded(&self, axis: usize, velocity: f64, lead: f64) -> f64 {
        if !velocity.is_finite() {
            return 0.0;
        }
        let kind = axis / 3;
        let velocity = velocity.clamp(-self.speed[kind], self.speed[kind]);
        // A command that leads too far waits for the robot; it is not pulled back.
        let [up, down] =
            [self.lead[kind] - lead, self.lead[kind] + lead].map(|room| room.max(0.0) / self.period_s);
        velocity.clamp(-down, up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a sum of some hundred steps, relative to the sum or in m.
    const ROUNDING: f64 = 1e-11;

    fn admittance(period_s: f64, limits: AdmittanceLimits) -> Admittance {
        let damping = [&Some(PerAxis::All(Positive::literal(100.0))), &None];
        let held = [false, false, true, false, false, false];
        let admittance = Admittance::new(damping, &limits, held, period_s, "force");
        admittance.expect("valid").expect("an axis has one")
    }

    /// Compared: the force on a spring wall of stiffness K under a robot that follows its commands at once, and
    /// f_target (1 − (1 − K T/B)^k), the solution of the difference equation; it converges only below K T/B = 2.
    #[test]
    fn force_on_spring_wall_follows_closed_form() {
        let (period_s, target) = (1e-3, 20.0);
        for stiffness in [1e3, 50e3, 150e3, 199e3, 210e3] {
            // An unstable force must not reach the limit of the lead.
            let limits =
                AdmittanceLimits { lead_m: Some(Positive::literal(1e9)), ..AdmittanceLimits::default() };
            let admittance = admittance(period_s, limits);
            // The wall pushes in +z against penetration in −z; the target is what it should exert ON the robot.
            let (mut x, pole) = (0.0, 1.0 - stiffness * period_s / 100.0);
            let mut expected = 0.0;
            for step in 1..=200 {
                let force = -stiffness * x;
                x += period_s * admittance.velocity(2, force - target, 0.0);
                expected = target * (1.0 - f64::powi(pole, step));
                // An error of rounding grows at most by the number of steps, or like the solution.
                let size = f64::max(target, f64::abs(expected));
                assert!((-stiffness * x - expected).abs() < ROUNDING * size, "K = {stiffness}, step {step}");
            }
            let settles = stiffness * period_s / 100.0 < 2.0;
            assert_eq!((expected - target).abs() <= target, settles, "K = {stiffness}: {expected} N");
        }
    }

    /// The speed is at most the limit; the lead grows to its limit exactly, and shrinks without a limit.
    #[test]
    fn speed_and_lead_are_bounded() {
        const LIMIT_M: f64 = 0.005;
        let limits = AdmittanceLimits {
            speed_m_per_s: Some(Positive::literal(0.1)),
            lead_m: Some(Positive::literal(LIMIT_M)),
            ..AdmittanceLimits::default()
        };
        let admittance = admittance(1e-3, limits);
        assert_eq!(admittance.velocity(2, -1e4, 0.0), -0.1);
        assert_eq!(admittance.velocity(2, f64::NAN, 0.0), 0.0);
        assert_eq!(admittance.velocity(0, 10.0, 0.0), 0.1);
        assert_eq!(admittance.velocity(3, 10.0, 0.0), 0.0, "a rotation without admittance");
        let mut lead = 0.0;
        for _ in 0..100 {
            lead += 1e-3 * admittance.velocity(2, -5.0, lead);
            assert!(lead >= -LIMIT_M - ROUNDING, "{lead}");
        }
        assert!((lead + LIMIT_M).abs() < ROUNDING);
        assert_eq!(admittance.velocity(2, 5.0, lead), 0.05);
        assert_eq!(admittance.velocity(2, -5.0, -0.1), 0.0, "waits, and is not pulled back");
    }
}
