//! Sums of sines, for circles, Lissajous figures and sweeps.
//!
//! ```text
//! x = Σ (b + a sin(2π f t + φ))
//! ```

use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// One sine along an axis: offset + amplitude · sin(2π · frequency · t + phase).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LinearWave {
    /// Amplitude, m.
    pub amplitude_m: f64,
    /// Frequency, Hz.
    pub frequency_hz: NonNegative,
    /// Phase at the start, rad.
    #[serde(default)]
    pub phase_rad: f64,
    /// Constant part, m.
    #[serde(default)]
    pub offset_m: f64,
}

/// One sine about an axis or of a joint: offset + amplitude · sin(2π · frequency · t + phase).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct AngularWave {
    /// Amplitude, rad (m for a prismatic joint).
    pub amplitude_rad: f64,
    /// Frequency, Hz.
    pub frequency_hz: NonNegative,
    /// Phase at the start, rad.
    #[serde(default)]
    pub phase_rad: f64,
    /// Constant part, rad (m for a prismatic joint).
    #[serde(default)]
    pub offset_rad: f64,
}

/// A sine with the angular frequency in rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wave {
    amplitude: f64,
    omega: f64,
    phase: f64,
    offset: f64,
}

impl From<&LinearWave> for Wave {
    fn from(w: &LinearWave) -> Self {
        let omega = TAU * w.frequency_hz.get();
        Self { amplitude: w.amplitude_m, omega, phase: w.phase_rad, offset: w.offset_m }
    }
}

impl From<&AngularWave> for Wave {
    fn from(w: &AngularWave) -> Self {
        let omega = TAU * w.frequency_hz.get();
        Self { amplitude: w.amplitude_rad, omega, phase: w.phase_rad, offset: w.offset_rad }
    }
}

/// Returns the sum of the waves and its first two derivatives at the time `t` (s).
pub(crate) fn sum(waves: &[Wave], t: f64) -> [f64; 3] {
    waves.iter().fold([0.0; 3], |[x, dx, ddx], w| {
        let (sin, cos) = (w.omega * t + w.phase).sin_cos();
        let a = w.amplitude;
        [x + w.offset + a * sin, dx + a * w.omega * cos, ddx - a * w.omega * w.omega * sin]
    })
}

/// Default time over which sinusoids are faded in, s.
#[must_use]
pub(crate) fn default_ramp_s() -> Positive {
    Positive::literal(1.0)
}
