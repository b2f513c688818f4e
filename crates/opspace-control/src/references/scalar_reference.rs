//! References of a scalar, such as an angle: its value, first and second derivative.
//!
//! ```text
//! point-to-point   x_d = x₀ + s(t) (x_goal − x₀)        sinusoid   x_d = x₀ + s(t) Σ (b + a sin(2π f t + φ))
//! ```
//!
//! s is the [minimum-jerk ramp](crate::references::ramp).
//!
//! Every reference starts, at time 0, at the current value.

use crate::references::online::{MotionLimits, OnlineMotion};
use crate::references::ramp::{Quintic, minimum_jerk, product};
use crate::references::target::BLEND_S;
use crate::references::wave;
use crate::references::wave::{AngularWave, Wave, default_ramp_s};
use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Reference of a coordinate, rad (m for a length).
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ScalarReference {
    /// Stays at the value at the start.
    #[default]
    Hold,
    /// Moves to one value with minimum jerk, and stays there.
    PointToPoint(ScalarPointToPoint),
    /// Oscillates about the value at the start.
    Sinusoid(ScalarSinusoid),
    /// Moves to one value as fast as limits allow, from any state of motion.
    Goal(ScalarOnlineGoal),
}

/// A minimum-jerk motion to one value.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScalarPointToPoint {
    /// Value to reach.
    pub goal: ScalarGoal,
    /// Duration of the motion, s.
    pub duration_s: Positive,
    /// Start time of the motion, s after the start of the reference.
    #[serde(default)]
    pub start_s: NonNegative,
}

/// Goal value.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum ScalarGoal {
    /// Absolute value, rad (m for a length); an angle moves the shorter way.
    #[serde(rename = "absolute_rad")]
    Absolute(f64),
    /// Offset from the value at the start of the run, rad (m for a length).
    #[serde(rename = "offset_rad")]
    Offset(f64),
}

/// A sum of sines, added to the value at the start.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScalarSinusoid {
    /// The sines.
    pub waves: Vec<AngularWave>,
    /// Duration over which the sines are faded in by the minimum-jerk ramp, s.
    #[serde(default = "default_ramp_s")]
    pub ramp_s: Positive,
}

/// A jerk-limited motion to one value.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScalarOnlineGoal {
    /// Value to reach.
    pub goal: ScalarGoal,
    /// Highest speed, rad/s (m/s).
    pub velocity_rad_per_s: Positive,
    /// Highest acceleration, rad/s² (m/s²).
    pub acceleration_rad_per_s2: Positive,
    /// Highest jerk, rad/s³ (m/s³).
    pub jerk_rad_per_s3: Positive,
}

/// Trajectory of a [`ScalarReference`]: values, first and second derivatives are stored together.
#[derive(Clone, Debug)]
pub(crate) struct ScalarTrajectory {
    from: f64,
    path: Path,
    /// Start time of the blend into the reference, s, and the fading distance from the reference.
    joining: Option<(f64, Quintic)>,
}

#[derive(Clone, Debug)]
enum Path {
    Hold,
    Ramp { goal: ScalarGoal, begin_s: f64, duration_s: f64, way: f64 },
    Waves { waves: Vec<Wave>, ramp_s: f64 },
    Online { goal: ScalarGoal, limits: MotionLimits, motion: Box<OnlineMotion> },
}

impl ScalarTrajectory {
    pub(crate) fn new(reference: &ScalarReference) -> Self {
        let path = match reference {
            ScalarReference::Hold => Path::Hold,
            ScalarReference::PointToPoint(p) => Path::Ramp {
                goal: p.goal,
                begin_s: p.start_s.get(),
                duration_s: p.duration_s.get(),
                way: 0.0,
            },
            ScalarReference::Sinusoid(s) => {
                Path::Waves { waves: s.waves.iter().map(Wave::from).collect(), ramp_s: s.ramp_s.get() }
            }
            ScalarReference::Goal(g) => Path::Online {
                goal: g.goal,
                limits: MotionLimits {
                    velocity: g.velocity_rad_per_s,
                    acceleration: g.acceleration_rad_per_s2,
                    jerk: g.jerk_rad_per_s3,
                },
                motion: Box::new(OnlineMotion::rest(0.0)),
            },
        };
        Self { from: 0.0, path, joining: None }
    }

    /// Starts now from the state `from`. `home` is the value at the start of the run; `difference(a, b)` returns a − b.
    /// Allocates nothing.
    pub(crate) fn start(&mut self, home: f64, from: [f64; 3], difference: impl Fn(f64, f64) -> f64) {
        let way = |goal: &ScalarGoal| match goal {
            ScalarGoal::Absolute(value) => difference(*value, from[0]),
            ScalarGoal::Offset(offset) => difference(home, from[0]) + offset,
        };
        self.from = from[0];
        self.joining = None;
        match &mut self.path {
            Path::Hold | Path::Waves { .. } => {}
            Path::Ramp { goal, way: to_go, .. } => *to_go = way(goal),
            Path::Online { goal, limits, motion } => {
                **motion = OnlineMotion::new(from, from[0] + way(goal), limits);
            }
        }
    }

    /// Starts a blend, at `time_s` (s) after the start, into the reference within [`BLEND_S`] from a value at rest with
    /// the offset `away` from the reference. Allocates nothing.
    pub(crate) fn join(&mut self, time_s: f64, away: f64) {
        let [_, rate, acceleration] = self.reference_at(time_s);
        self.joining = Some((time_s, Quintic::new([away, -rate, -acceleration], 0.0, BLEND_S)));
    }

    /// Returns true if it is a jerk-limited motion, which can start from any state of motion.
    pub(crate) fn is_online(&self) -> bool {
        matches!(self.path, Path::Online { .. })
    }

    /// Target at `time_s` (s) after the start.
    pub(crate) fn at(&self, time_s: f64) -> [f64; 3] {
        let reference = self.reference_at(time_s);
        match &self.joining {
            Some((begin_s, away)) if time_s < begin_s + BLEND_S => {
                let away = away.at(time_s - begin_s);
                [reference[0] + away[0], reference[1] + away[1], reference[2] + away[2]]
            }
            _ => reference,
        }
    }

    /// Reference at `time_s` (s) after the start, without blending.
    pub(crate) fn reference_at(&self, time_s: f64) -> [f64; 3] {
        match &self.path {
            Path::Hold => [self.from, 0.0, 0.0],
            Path::Ramp { begin_s, duration_s, way, .. } => {
                let [s, ds, dds] = minimum_jerk(time_s - begin_s, *duration_s);
                [self.from + way * s, way * ds, way * dds]
            }
            Path::Waves { waves, ramp_s } => {
                let [x, dx, ddx] = product(minimum_jerk(time_s, *ramp_s), wave::sum(waves, time_s));
                [self.from + x, dx, ddx]
            }
            Path::Online { motion, .. } => motion.at(time_s),
        }
    }
}
