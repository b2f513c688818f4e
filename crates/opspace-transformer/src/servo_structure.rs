//! Trait of a structure of servos: its law, its gains, and their meaning.
//!
//! Each structure is one implementation, in a file of its own: [`cascaded_servo`](crate::cascaded_servo),
//! [`pid_servo`](crate::pid_servo), [`transfer_function_servo`](crate::transfer_function_servo) and
//! [`velocity_servo`](crate::velocity_servo). The list of them is in [`servo`](crate::servo).

use crate::remaining_damping::RemainingDamping;
use crate::servo_gains::ServoGains;
use crate::servo_law::{ServoError, ServoLaw, SetpointParameters};
use opspace_backend::CommandKind;
use opspace_backend::quantity::{NonNegative, Positive};

/// Structure of a servo, with its parameters.
pub trait ServoStructure {
    /// Quantity of its setpoint: position, or velocity.
    fn takes(&self) -> CommandKind {
        CommandKind::Position
    }

    /// Returns the law of a loop that runs every `period_s` (s).
    ///
    /// # Errors
    /// Parameters that are contradictory, or a law that is not realizable.
    fn law(&self, period_s: f64) -> Result<ServoLaw, ServoError>;

    /// Equivalent gains of a servo that runs every `period_s` (s).
    fn gains(&self, period_s: f64) -> ServoGains;

    /// Filter and feed-forward of the setpoint; none by default.
    fn setpoint(&self) -> SetpointParameters {
        SetpointParameters::default()
    }

    /// True if the loop consists of two gains only: stiffness on the position error, and damping on the filtered velocity, or on
    /// its difference from a fraction of the setpoint's velocity.
    fn has_two_gains(&self) -> bool {
        false
    }

    /// Time by which the setpoint for a constant torque leads a joint of constant velocity, without feed-forward and filter, s.
    fn lead_s(&self) -> f64 {
        0.0
    }

    /// Half-width of the interval in which the true gains lie, as a fraction of the stated ones; `None` if it is not stated.
    fn gain_uncertainty(&self) -> Option<f64> {
        None
    }

    /// Least damping that a transformer leaves to the joint so that no gains of the interval of this half-width drive it; none by
    /// default.
    fn remaining_damping(&self, _gain_uncertainty: f64) -> RemainingDamping {
        RemainingDamping::default()
    }

    /// Multiplies the gain of the position loop by `kp`, and the gain of the whole servo by `kv`.
    fn scale(&mut self, kp: f64, kv: f64);

    /// Cut-off frequency of the filter on the velocity, Hz; `None` without such a filter.
    fn velocity_filter_hz(&mut self) -> Option<&mut Positive> {
        None
    }

    /// Returns how gains that were identified are written as such a servo.
    ///
    /// # Errors
    /// Description of a servo that cannot be identified: "a transfer function".
    fn identified(&self) -> Result<IdentifiedKeys, &'static str>;
}

/// Keys of a servo of identified gains, with their values.
pub type IdentifiedKeys = fn(&IdentifiedGains) -> [(&'static str, f64); 3];

/// Gains of a servo that were identified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdentifiedGains {
    /// Gain of the position loop, 1/s.
    pub kp_per_s: f64,
    /// Damping, Nms/rad (Ns/m).
    pub kv_nms_per_rad: f64,
    /// Cut-off frequency of the filter on the velocity, Hz.
    pub filter_hz: f64,
}

/// Returns the value multiplied by `scale`; the value itself if the product is out of range.
pub(crate) fn times(value: Positive, scale: f64) -> Positive {
    Positive::try_from(value.get() * scale).unwrap_or(value)
}

/// Returns the value, which may be zero, multiplied by `scale`; the value itself if the product is out of range.
pub(crate) fn times_or_zero(value: NonNegative, scale: f64) -> NonNegative {
    NonNegative::try_from(value.get() * scale).unwrap_or(value)
}
