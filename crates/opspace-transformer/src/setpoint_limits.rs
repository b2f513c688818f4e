//! Limits that drives impose on their setpoints: velocity, acceleration and jerk of the sequence of setpoints, by finite
//! differences at the interface rate.
//!
//! With the setpoint x of this interface cycle, x₋ of the one before and the interface period T:
//!
//! ```text
//! v = (x − x₋)/T        a = (v − v₋)/T        j = (a − a₋)/T
//! ```
//!
//! A velocity robot accepts velocities: its setpoint is v itself, and position differences do not exist. The setpoints of
//! the differences are the commanded ones, refused ones included, so that a drive refuses an outlier and the three
//! setpoints after it. Of a drive that clamps they are those that act. A drive that gets no setpoint is at rest at its
//! last one: v and a are zero.

use opspace_backend::CommandKind;
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Fraction by which a difference may exceed its limit, for rounding.
const ROUNDING: f64 = 1e-6;

/// Limits of the setpoints of a robot's drives, and their reaction to a setpoint beyond them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct SetpointLimitParameters {
    /// Reaction to a setpoint beyond a limit.
    pub reaction: SetpointReaction,
    /// Limits of each joint, by joint name; none for omitted joints.
    pub joint: BTreeMap<String, JointSetpointLimits>,
}

/// Reaction of a drive to a setpoint beyond its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SetpointReaction {
    /// It takes the nearest setpoint within the limits; velocity comes before acceleration, acceleration before jerk.
    Clamp,
    /// It ignores the setpoint and keeps the last one that it accepted.
    Refuse,
    /// It stops the robot with a fault.
    Stop,
}

/// Limits of the setpoints of a joint; an omitted one is no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct JointSetpointLimits {
    /// Largest velocity, rad/s (m/s).
    pub velocity_rad_per_s: Option<Positive>,
    /// Largest acceleration, rad/s² (m/s²).
    pub acceleration_rad_per_s2: Option<Positive>,
    /// Largest jerk, rad/s³ (m/s³).
    pub jerk_rad_per_s3: Option<Positive>,
}

/// Limit that a setpoint exceeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SetpointLimit {
    /// Largest velocity.
    Velocity,
    /// Largest acceleration.
    Acceleration,
    /// Largest jerk.
    Jerk,
}

impl SetpointLimit {
    /// All limits, in the order in which they are checked.
    pub const ALL: [Self; 3] = [Self::Velocity, Self::Acceleration, Self::Jerk];

    /// Name of the limited quantity.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
        }
    }
}

/// Sequence of setpoints of one joint.
#[derive(Clone, Copy, Debug)]
pub struct SetpointStream {
    period_s: f64,
    /// Limits of the setpoint and of its first three differences; infinite where there is none.
    limits: [f64; 4],
    /// Number of the difference that is the velocity: 1, or 0 for velocity setpoints.
    velocity: usize,
    /// Last setpoint, and its first two differences; `None` before the first setpoint.
    last: Option<[f64; 3]>,
}

impl SetpointStream {
    /// Returns the sequence before its first setpoint, with an interface period of `period_s` (s). `takes` is the
    /// quantity of the setpoints: position or velocity.
    #[must_use]
    pub fn new(limits: &JointSetpointLimits, takes: CommandKind, period_s: f64) -> Self {
        let velocity = usize::from(takes != CommandKind::Velocity);
        let given = [limits.velocity_rad_per_s, limits.acceleration_rad_per_s2, limits.jerk_rad_per_s3];
        let mut all = [f64::INFINITY; 4];
        for (to, limit) in all[velocity..].iter_mut().zip(given) {
            *to = limit.map_or(f64::INFINITY, Positive::get);
        }
        Self { period_s, limits: all, velocity, last: None }
    }

    /// Setpoint and its differences: velocity, acceleration and jerk of a position.
    fn differences(&self, last: [f64; 3], setpoint: f64) -> [f64; 4] {
        let first = (setpoint - last[0]) / self.period_s;
        let second = (first - last[1]) / self.period_s;
        [setpoint, first, second, (second - last[2]) / self.period_s]
    }

    /// Returns the first limit that the next setpoint (rad, m; rad/s, m/s for a velocity robot) would exceed. The first
    /// setpoint of a sequence exceeds none, except a velocity that exceeds its limit.
    #[must_use]
    pub fn exceeds(&self, setpoint: f64) -> Option<SetpointLimit> {
        let values = match self.last {
            Some(last) => self.differences(last, setpoint),
            None => [setpoint, 0.0, 0.0, 0.0],
        };
        let limited = values.iter().zip(&self.limits).skip(self.velocity).zip(SetpointLimit::ALL);
        let mut exceeded = limited.filter(|((value, limit), _)| value.abs() > *limit * (1.0 + ROUNDING));
        exceeded.next().map(|(_, limit)| limit)
    }

    /// Returns the setpoint within the limits that is nearest to `setpoint`: its differences are limited from the highest
    /// one down.
    #[must_use]
    pub fn clamp(&self, setpoint: f64) -> f64 {
        let limit = |i: usize, value: f64| value.clamp(-self.limits[i], self.limits[i]);
        let Some(last) = self.last else {
            return limit(0, setpoint);
        };
        if self.exceeds(setpoint).is_none() {
            return setpoint;
        }
        let [_, _, _, third] = self.differences(last, setpoint);
        let second = limit(2, last[2] + self.period_s * limit(3, third));
        let first = limit(1, last[1] + self.period_s * second);
        limit(0, last[0] + self.period_s * first)
    }

    /// Adds a setpoint (rad, m; rad/s, m/s).
    pub fn take(&mut self, setpoint: f64) {
        let [setpoint, first, second, _] = match self.last {
            Some(last) => self.differences(last, setpoint),
            None => [setpoint, 0.0, 0.0, 0.0],
        };
        self.last = Some([setpoint, first, second]);
    }

    /// Keeps the last setpoint, at rest there.
    pub fn keep(&mut self) {
        if let Some(last) = &mut self.last {
            *last = [last[0], 0.0, 0.0];
        }
    }

    /// Forgets the setpoints: the next one is the first.
    pub fn restart(&mut self) {
        self.last = None;
    }
}
