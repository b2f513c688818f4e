//! Nominal position and velocity servos of drives, which a transformer inverts: one of the structures that there are.
//!
//! A [`ServoLaw`] computes the torque of each servo at every servo tick.

use crate::cascaded_servo::CascadedServo;
use crate::pid_servo::PidServo;
use crate::remaining_damping::RemainingDamping;
use crate::servo_gains::ServoGains;
use crate::servo_law::{ServoError, ServoLaw};
use crate::servo_structure::ServoStructure;
use crate::setpoint_filter::SetpointFilter;
use crate::transfer_function_servo::TransferFunctionServo;
use crate::velocity_servo::VelocityServo;
use opspace_backend::CommandKind;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

macro_rules! structures {
    ($($(#[$doc:meta])* $variant:ident($structure:ty) $name:literal,)*) => {
        /// Servo of a joint.
        #[derive(Clone, Debug, PartialEq, Deserialize)]
        #[cfg_attr(feature = "schema", derive(JsonSchema))]
        #[serde(deny_unknown_fields)]
        #[non_exhaustive]
        pub enum ServoParameters {
            $(
                $(#[$doc])*
                #[serde(rename = $name)]
                $variant($structure),
            )*
        }

        impl ServoParameters {
            /// Names of the structures in files.
            pub const NAMES: &[&'static str] = &[$($name),*];

            /// Name of its structure in files.
            #[must_use]
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant(_) => $name,)*
                }
            }

            /// Structure with its parameters.
            #[must_use]
            pub fn structure(&self) -> &dyn ServoStructure {
                match self {
                    $(Self::$variant(servo) => servo,)*
                }
            }

            /// Structure whose parameters can be changed.
            pub fn structure_mut(&mut self) -> &mut dyn ServoStructure {
                match self {
                    $(Self::$variant(servo) => servo,)*
                }
            }
        }
    };
}

structures! {
    /// Position loop around a velocity loop.
    Cascaded(CascadedServo) "cascaded",
    /// Single loop: proportional, derivative, and optionally integral.
    Pid(PidServo) "pid",
    /// Any other linear servo: torque over position error.
    TransferFunction(TransferFunctionServo) "transfer-function",
    /// Velocity loop, for a robot that accepts velocities.
    Velocity(VelocityServo) "velocity",
}

impl ServoLaw {
    /// Returns the law of a servo that runs every `period_s` (s).
    ///
    /// # Errors
    /// If the transfer function is not realizable, or the servo cannot hold a torque at rest.
    pub fn new(servo: &ServoParameters, period_s: f64) -> Result<Self, ServoError> {
        servo.structure().law(period_s)?.completed(servo.setpoint_filter(), period_s)
    }
}

impl ServoParameters {
    /// Quantity of its setpoint: position, or velocity.
    #[must_use]
    pub fn takes(&self) -> CommandKind {
        self.structure().takes()
    }

    /// Equivalent gains of a servo that runs every `period_s` (s). Those of a transfer function are evaluated at a
    /// hundredth of the servo rate. The stiffness of a velocity servo is zero.
    #[must_use]
    pub fn gains(&self, period_s: f64) -> ServoGains {
        self.structure().gains(period_s)
    }

    /// True if the servo consists of these two gains only: stiffness on the position error, and damping on the filtered
    /// velocity, or on its difference from a fraction of the setpoint's velocity. The setpoint may be a moving average.
    #[must_use]
    pub fn has_two_gains(&self) -> bool {
        self.structure().has_two_gains()
            && self.acceleration_feed_forward_kg_m2() == 0.0
            && self.setpoint_filter().is_none_or(|filter| filter.precedes_law())
    }

    /// Fraction of the setpoint's velocity that is fed forward; 0 for a transfer function and a velocity servo.
    #[must_use]
    pub fn velocity_feed_forward(&self) -> f64 {
        self.structure().setpoint().velocity_feed_forward
    }

    /// Half-width of the interval in which the true gains lie, as a fraction of the stated ones; `None` if it is not stated.
    #[must_use]
    pub fn gain_uncertainty(&self) -> Option<f64> {
        self.structure().gain_uncertainty()
    }

    /// Least damping that a transformer without motor current leaves to the joint so that no gains within `gain_uncertainty` of
    /// the stated ones (a fraction of them) drive it.
    #[must_use]
    pub fn remaining_damping(&self, gain_uncertainty: f64) -> RemainingDamping {
        self.structure().remaining_damping(gain_uncertainty)
    }

    /// Torque fed forward per acceleration of the setpoint, kg m² (kg); 0 for a transfer function and a velocity servo.
    #[must_use]
    pub fn acceleration_feed_forward_kg_m2(&self) -> f64 {
        self.structure().setpoint().acceleration_feed_forward_kg_m2
    }

    /// Filter of the setpoint, if any.
    #[must_use]
    pub fn setpoint_filter(&self) -> Option<SetpointFilter> {
        self.structure().setpoint().filter
    }

    /// Time by which the setpoint's filter lags, s; zero without one.
    #[must_use]
    pub fn setpoint_filter_lag_s(&self) -> f64 {
        self.setpoint_filter().map_or(0.0, |filter| filter.lag_s())
    }

    /// Time by which the setpoint for a constant torque leads a joint of constant velocity, s: `1/kp` of a cascade, less what
    /// is fed forward, and the lag of the setpoint's filter. Zero for a transfer function and a velocity servo.
    #[must_use]
    pub fn setpoint_lead_s(&self) -> f64 {
        (1.0 - self.velocity_feed_forward()) * self.structure().lead_s() + self.setpoint_filter_lag_s()
    }

    /// True if the setpoint acts on the position error only, and unfiltered: no feed-forward and no setpoint filter.
    #[must_use]
    pub fn has_plain_setpoint(&self) -> bool {
        self.velocity_feed_forward() == 0.0
            && self.acceleration_feed_forward_kg_m2() == 0.0
            && self.setpoint_filter().is_none()
    }

    /// Returns this servo with the gain of its position loop multiplied by `kp` and the gain of the whole servo
    /// multiplied by `kv`. A velocity servo has no position loop and ignores `kp`. The acceleration feed-forward is
    /// unchanged.
    #[must_use]
    pub fn scaled(&self, kp: f64, kv: f64) -> Self {
        let mut scaled = self.clone();
        scaled.structure_mut().scale(kp, kv);
        scaled
    }
}
