//! Interval of each servo's true gains: how far they may be from the nominal ones.

use crate::files::robot::RobotDefinition;
use crate::files::source::KeyPath;
use opspace_transformer::ServoParameters;

/// Half-width of the interval of gains that are declared without one, as a fraction of them.
pub const DECLARED: f64 = 0.05;

/// Half-width of the interval of gains that are listed in `assumed`, as a fraction of them.
pub const ASSUMED: f64 = 0.3;

/// Source of an interval of gains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IntervalSource {
    /// `gain_uncertainty` of the servo.
    Stated,
    /// Gains that are declared without an interval.
    Declared,
    /// Gains that robot.toml lists in `assumed`.
    Assumed,
}

/// Interval of the true gains of a servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GainInterval {
    /// Half-width, as a fraction of the nominal gains.
    pub half_width: f64,
    /// Source of the half-width.
    pub source: IntervalSource,
}

impl GainInterval {
    /// Interval of gains that are declared without one.
    pub const DECLARED: Self = Self { half_width: DECLARED, source: IntervalSource::Declared };

    /// Returns the interval of the servo of joint `joint`, which table `table` of profile `profile` contains: `servo` or
    /// `velocity_servo`.
    pub(crate) fn of(
        robot: &RobotDefinition,
        [profile, table]: [&str; 2],
        joint: &str,
        servo: &ServoParameters,
    ) -> Self {
        if let Some(half_width) = servo.gain_uncertainty() {
            return Self { half_width, source: IntervalSource::Stated };
        }
        // A key of a group of joints counts for all joints.
        let is_joint = |name: &str| robot.model.joint(name).is_ok();
        let covers =
            |key: &String| match key.segments().iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
                ["profile", name] => *name == profile,
                ["profile", name, of] => *name == profile && *of == table,
                ["profile", name, of, whose, ..] => {
                    *name == profile && *of == table && (*whose == joint || !is_joint(whose))
                }
                _ => false,
            };
        if robot.file.assumed.iter().any(covers) {
            return Self { half_width: ASSUMED, source: IntervalSource::Assumed };
        }
        Self::DECLARED
    }
}
