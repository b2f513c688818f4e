//! 95 % intervals of the estimates.

use serde::Serialize;

/// Interval that holds the true value in 95 % of identifications. It is an array of two numbers in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(into = "[f64; 2]")]
pub struct Interval95 {
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

impl From<Interval95> for [f64; 2] {
    fn from(interval: Interval95) -> Self {
        [interval.lower, interval.upper]
    }
}

/// Half-width of a 95 % interval in standard deviations of a Gaussian estimate.
const NORMAL_95: f64 = 1.96;

/// Half-width of a 95 % interval in standard deviations that are estimated from residuals with this many degrees of
/// freedom (above 0): the quantile of Student's t distribution.
#[must_use]
pub fn student_95(degrees: usize) -> f64 {
    const FIRST: [f64; 10] = [12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23];
    // The expansion of Cornish and Fisher to first order, from the 11th on within half a percent.
    let beyond = || NORMAL_95 * (1.0 + (NORMAL_95 * NORMAL_95 + 1.0) / (4.0 * degrees as f64));
    FIRST.get(degrees.saturating_sub(1)).copied().unwrap_or_else(beyond)
}

impl Interval95 {
    /// Returns the interval of a positive estimate whose logarithm is Gaussian with this standard deviation.
    #[must_use]
    pub fn of_logarithm(value: f64, deviation: f64) -> Self {
        let factor = (NORMAL_95 * deviation).exp();
        Self { lower: value / factor, upper: value * factor }
    }

    /// Returns the interval of a Gaussian estimate with this standard deviation.
    #[must_use]
    pub fn of(value: f64, deviation: f64) -> Self {
        Self { lower: value - NORMAL_95 * deviation, upper: value + NORMAL_95 * deviation }
    }

    /// Half of its width.
    #[must_use]
    pub fn half_width(&self) -> f64 {
        0.5 * (self.upper - self.lower)
    }

    /// Returns the interval that contains both.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        Self { lower: self.lower.min(other.lower), upper: self.upper.max(other.upper) }
    }

    /// Returns the interval of the estimate plus `by`.
    #[must_use]
    pub fn shifted(&self, by: f64) -> Self {
        Self { lower: self.lower + by, upper: self.upper + by }
    }

    /// Returns the interval of the estimate times `factor` (above 0).
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { lower: self.lower * factor, upper: self.upper * factor }
    }
}

/// Intervals of a servo's estimates, in their units; `None` where the measurement does not determine one.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ServoIntervals {
    /// Position gain.
    pub kp: Option<Interval95>,
    /// Velocity gain.
    pub kv: Option<Interval95>,
    /// Cut-off of the velocity filter.
    pub velocity_filter_hz: Option<Interval95>,
    /// Delay, servo ticks.
    pub delay: Option<Interval95>,
    /// Inertia.
    pub inertia: Option<Interval95>,
    /// Coulomb friction.
    pub coulomb: Option<Interval95>,
    /// Viscous friction.
    pub viscous: Option<Interval95>,
}
