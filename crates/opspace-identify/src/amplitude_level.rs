//! Frequency responses of a joint at one amplitude.

use crate::background::Background;
use crate::response::Point;

/// Frequency responses at one amplitude.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct AmplitudeLevel {
    /// Rms of the joint's velocity, rad/s (m/s).
    pub speed: f64,
    /// Response of position to setpoint.
    pub position: Vec<Point>,
    /// Response of mean torque to setpoint, Nm/rad (N/m), if current is measured.
    pub torque: Option<Vec<Point>>,
    /// Responses at the lines that are not excited, if current is measured.
    pub(crate) background: Option<Background>,
}
