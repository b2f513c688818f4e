//! Gains of motion axes, and the integration of an error.

use crate::error::ControlError;
use crate::tasks::axes::PerAxis;
use nalgebra::Vector6;
use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Feedback of a motion axis: a unit mass with a spring and a damper, independent of the arm's inertia.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct AxisGains {
    /// Natural frequency ω of the error, rad/s: the stiffness is ω² (1/s²).
    pub frequency_rad_per_s: PerAxis<Positive>,
    /// Damping ratio ζ of the error: the damping is 2ζω (1/s).
    pub damping_ratio: PerAxis<NonNegative>,
    /// Integral gain, 1/s: fraction of the error that is added to the integral per second. It removes errors caused by
    /// friction and model errors; at most about a quarter of the natural frequency is recommended.
    #[serde(default = "no_integral")]
    pub integral_per_s: PerAxis<NonNegative>,
    /// Upper bound of the integral along an axis, m.
    #[serde(default = "default_integral_limit")]
    pub integral_limit_m: PerAxis<NonNegative>,
    /// Upper bound of the integral about an axis, rad.
    #[serde(default = "default_integral_limit_rad")]
    pub integral_limit_rad: PerAxis<NonNegative>,
}

impl AxisGains {
    /// Creates gains with one natural frequency (rad/s) and one damping ratio for all axes, without integral.
    ///
    /// # Errors
    /// A frequency that is not positive, a negative ratio.
    pub fn new(frequency_rad_per_s: f64, damping_ratio: f64) -> Result<Self, ControlError> {
        let frequency = Positive::try_from(frequency_rad_per_s);
        let ratio = NonNegative::try_from(damping_ratio);
        Ok(Self {
            frequency_rad_per_s: PerAxis::All(
                frequency.map_err(|message| ControlError::value("frequency_rad_per_s", message))?,
            ),
            damping_ratio: PerAxis::All(
                ratio.map_err(|message| ControlError::value("damping_ratio", message))?,
            ),
            integral_per_s: no_integral(),
            integral_limit_m: default_integral_limit(),
            integral_limit_rad: default_integral_limit_rad(),
        })
    }
}

fn no_integral() -> PerAxis<NonNegative> {
    PerAxis::All(NonNegative::literal(0.0))
}

fn default_integral_limit() -> PerAxis<NonNegative> {
    PerAxis::All(NonNegative::literal(0.05))
}

fn default_integral_limit_rad() -> PerAxis<NonNegative> {
    PerAxis::All(NonNegative::literal(0.2))
}

/// Adds `step` times an error to its integral, bounded by ±`limit`. An error that is not finite is ignored, so that it
/// has no effect on later cycles.
pub(crate) fn integrate(
    integral: &mut Vector6<f64>,
    error: &Vector6<f64>,
    step: &Vector6<f64>,
    limit: &Vector6<f64>,
) {
    for i in (0..6).filter(|&i| error[i].is_finite()) {
        integral[i] = (integral[i] + step[i] * error[i]).clamp(-limit[i], limit[i]);
    }
}
