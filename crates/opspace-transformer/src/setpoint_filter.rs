//! Filter of a drive's setpoint.

use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Filter of a drive's setpoint. Low-pass filters are exact for setpoints that are constant over each servo period; their output
/// at a servo tick is the value at the end of the period that begins there.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum SetpointFilter {
    /// `ω/(s + ω)`, with ω = 2π `cutoff_hz`.
    FirstOrder {
        /// Cut-off frequency (−3 dB), Hz.
        cutoff_hz: Positive,
    },
    /// `ω²/(s² + 2 ζ ω s + ω²)`, with ω = 2π `natural_frequency_hz` and ζ = `damping_ratio`.
    SecondOrder {
        /// Natural frequency, Hz.
        natural_frequency_hz: Positive,
        /// Damping ratio; 1 is critical.
        damping_ratio: Positive,
    },
    /// Mean of the setpoints of the last `time_s`, and of these means over `second_time_s`: what drives call jerk time or
    /// smoothing time. A step of the setpoint's velocity becomes an acceleration that is constant for `time_s`, or, with a second
    /// average, one that rises and falls with a bounded jerk. Both times are rounded to servo periods, at least one.
    MovingAverage {
        /// Time over which setpoints are averaged, s.
        time_s: Positive,
        /// Time over which the averages are averaged again, s; once only if absent.
        second_time_s: Option<Positive>,
    },
}

impl SetpointFilter {
    /// Time by which the output lags behind a setpoint of constant velocity, s.
    pub(crate) fn lag_s(&self) -> f64 {
        match self {
            Self::FirstOrder { cutoff_hz } => 1.0 / (TAU * cutoff_hz.get()),
            Self::SecondOrder { natural_frequency_hz, damping_ratio } => {
                2.0 * damping_ratio.get() / (TAU * natural_frequency_hz.get())
            }
            Self::MovingAverage { time_s, second_time_s } => {
                0.5 * (time_s.get() + second_time_s.map_or(0.0, Positive::get))
            }
        }
    }

    /// True if the filter's output is no state of the servo's law: a moving average, which precedes it.
    pub(crate) fn precedes_law(&self) -> bool {
        matches!(self, Self::MovingAverage { .. })
    }
}
