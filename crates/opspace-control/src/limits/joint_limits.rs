//! Limits of a robot's joints, and the part of them that a controller uses.

use crate::error::ControlError;
use crate::limits::horizon::{HORIZON_PERIODS, horizon_s};
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::Model;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Limits of a robot's joints: one value per joint; infinite if there is no limit.
#[derive(Clone, Debug, PartialEq)]
pub struct JointLimits {
    /// Lowest position, rad or m (n).
    pub lower: Vec<f64>,
    /// Highest position, rad or m (n).
    pub upper: Vec<f64>,
    /// Highest speed, rad/s or m/s (n).
    pub velocity: Vec<f64>,
    /// Highest acceleration, rad/s² or m/s² (n). When a joint has to brake before a position limit, its deceleration is
    /// at most this value, and at most half of what the torque limit leaves besides gravity in the worst of many
    /// postures.
    pub acceleration: Vec<f64>,
    /// Highest torque, Nm or N (n).
    pub torque: Vec<f64>,
    /// Highest rate of the commanded torque, Nm/s or N/s (n). If it is infinite and the torque is limited, the torque
    /// may rise from zero to its limit in 10 ms.
    pub torque_rate: Vec<f64>,
}

/// Enforcement of the robot's limits by the controller.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct LimitParameters {
    /// True (the default) if the controller enforces the limits. If false, torques are only clipped, and the run
    /// stops when a joint reaches its limit.
    pub enforce: bool,
    /// Margin between joints and their position limits, rad (m).
    pub position_margin_rad: NonNegative,
    /// Fraction of the velocity limits that is used, from 0 to 1.
    pub velocity_fraction: Positive,
    /// Fraction of the torque limits that is used, from 0 to 1.
    pub torque_fraction: Positive,
    /// Horizon at which velocities and positions must be within their limits, s, from five control periods to 0.5. A longer
    /// horizon makes the arm approach its limits earlier and more smoothly; a shorter one passes more of the noise of
    /// velocities on to the torques, and below five control periods a torque that acts a period late would exceed the
    /// limits.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = format!("{}, or {HORIZON_PERIODS} control periods if that is more", crate::limits::horizon::HORIZON_S))))]
    pub horizon_s: Option<Positive>,
    /// Weight of a task's deviations perpendicular to its direction of motion, relative to those along it, from 1 to 100.
    /// With 10, a task that limits slow down stays within a few degrees of its path; with 1, no direction is preferred.
    /// `when_limited = "scaled"` of a task keeps its direction more strictly.
    #[cfg_attr(feature = "schema", schemars(extend("minimum" = 1, "maximum" = LARGEST_LATERAL_WEIGHT)))]
    pub lateral_weight: Positive,
    /// A task that cannot reach its goal comes to a standstill when its error decreases by less than this, m/s (rotations
    /// count with the length of the task). With 0 it goes on trying, and the arm may not come to rest.
    pub standstill_below_m_per_s: NonNegative,
}

impl Default for LimitParameters {
    fn default() -> Self {
        Self {
            enforce: true,
            position_margin_rad: NonNegative::literal(0.01),
            velocity_fraction: Positive::literal(0.9),
            torque_fraction: Positive::literal(1.0),
            horizon_s: None,
            lateral_weight: Positive::literal(10.0),
            standstill_below_m_per_s: NonNegative::literal(1e-3),
        }
    }
}

/// Longest horizon that can be set, s: with a longer one, joints hardly reach their limits.
const LONGEST_HORIZON_S: f64 = 0.5;

/// Largest lateral weight that can be set: a larger one would be lost in the accuracy of the solver.
const LARGEST_LATERAL_WEIGHT: f64 = 100.0;

impl LimitParameters {
    /// Checks the values whose range depends on the control period, s, or on the solver.
    pub(crate) fn check(&self, period_s: f64) -> Result<(), ControlError> {
        let least = HORIZON_PERIODS * period_s;
        if let Some(horizon_s) = self.horizon_s.map(Positive::get)
            && !(horizon_s >= least && (horizon_s <= LONGEST_HORIZON_S || horizon_s <= 2.0 * least))
        {
            let message = format!(
                "the horizon must be from {least} s, five control periods, so that a torque that acts a period late \
                 keeps the limits, to {LONGEST_HORIZON_S} s, so that joints can come near them; got {horizon_s} s"
            );
            return Err(ControlError::value("limits.horizon_s", message));
        }
        let weight = self.lateral_weight.get();
        if !(1.0..=LARGEST_LATERAL_WEIGHT).contains(&weight) {
            let message = format!(
                "the weight must be from 1, which prefers no direction, to {LARGEST_LATERAL_WEIGHT}, as a larger one \
                 would be lost in the accuracy of the solver; got {weight}"
            );
            return Err(ControlError::value("limits.lateral_weight", message));
        }
        Ok(())
    }

    /// Horizon for a control period, s; at least five control periods.
    pub(crate) fn horizon_s(&self, period_s: f64) -> f64 {
        let given = self.horizon_s.map(|horizon_s| horizon_s.get().max(HORIZON_PERIODS * period_s));
        given.unwrap_or_else(|| horizon_s(period_s))
    }

    /// Weight of errors perpendicular to the direction of a task, in its range.
    pub(crate) fn lateral_weight(&self) -> f64 {
        self.lateral_weight.get().clamp(1.0, LARGEST_LATERAL_WEIGHT)
    }
}

/// Rise time of the command to the torque limit if no rate is given, s.
const TORQUE_RISE_S: f64 = 0.01;

impl JointLimits {
    /// Returns unlimited values for `n` joints.
    #[must_use]
    pub fn none(n: usize) -> Self {
        let none = vec![f64::INFINITY; n];
        Self {
            lower: vec![f64::NEG_INFINITY; n],
            upper: none.clone(),
            velocity: none.clone(),
            acceleration: none.clone(),
            torque: none.clone(),
            torque_rate: none,
        }
    }

    /// Returns the limits of the URDF: position, velocity and effort.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        let each =
            |of: fn(&opspace_model::Limits) -> f64| model.joints().iter().map(|j| of(&j.limits)).collect();
        Self {
            lower: each(|l| l.lower),
            upper: each(|l| l.upper),
            velocity: each(|l| l.velocity),
            torque: each(|l| l.effort),
            ..Self::none(model.n())
        }
    }

    /// Narrows the limits by the margins and fractions, and adds the default torque rates.
    pub(crate) fn narrowed(mut self, parameters: &LimitParameters) -> Self {
        let margin = parameters.position_margin_rad.get();
        for i in 0..self.lower.len() {
            // A range that is narrower than its margins shrinks to its centre.
            let middle = 0.5 * (self.lower[i] + self.upper[i]);
            let keep = |end: f64| if middle.is_finite() { end } else { f64::NAN };
            self.lower[i] = (self.lower[i] + margin).min(keep(middle));
            self.upper[i] = (self.upper[i] - margin).max(keep(middle));
            self.velocity[i] *= parameters.velocity_fraction.get().min(1.0);
            self.torque[i] *= parameters.torque_fraction.get().min(1.0);
            if self.torque_rate[i] == f64::INFINITY {
                self.torque_rate[i] = self.torque[i] / TORQUE_RISE_S;
            }
        }
        self
    }
}
