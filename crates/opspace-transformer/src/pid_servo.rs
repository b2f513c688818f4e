//! Single loop: proportional, derivative, and optionally integral.

use crate::remaining_damping::RemainingDamping;
use crate::servo_gains::ServoGains;
use crate::servo_law::{
    Form, SETPOINT_BEFORE, ServoError, ServoLaw, SetpointParameters, SetpointPath, filtered_rate,
};
use crate::servo_structure::{IdentifiedKeys, ServoStructure, times, times_or_zero};
use crate::setpoint_filter::SetpointFilter;
use opspace_backend::quantity::{Fraction, NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `τ = K e + D ė + Ki ∫ e`, with e = q_d − q, and ė or −q̇ from a filtered finite difference.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = crate::optional_keys::with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct PidServo {
    /// Stiffness K, Nm/rad (N/m).
    pub stiffness_nm_per_rad: Positive,
    /// Damping D, Nms/rad (Ns/m).
    pub damping_nms_per_rad: NonNegative,
    /// Cut-off frequency of the low-pass filter on the finite difference, Hz; required if the damping is not zero.
    pub derivative_filter_hz: Option<Positive>,
    /// Differentiated quantity.
    #[serde(default)]
    pub derivative_of: DerivativeOf,
    /// Integral gain Ki, Nm/(rad s) (N/(m s)).
    #[serde(default)]
    pub integral_nm_per_rad_s: NonNegative,
    /// Fraction of the setpoint's velocity that is fed forward: the torque `D velocity_feed_forward (q_d −
    /// q_d₋)/T_s` is added, with q_d₋ of the servo tick before. Zero with the derivative of the error.
    #[serde(default)]
    pub velocity_feed_forward: Fraction,
    /// Torque fed forward per acceleration of the setpoint (its second difference divided by T_s²), kg m² (kg).
    #[serde(default)]
    pub acceleration_feed_forward_kg_m2: NonNegative,
    /// Filter of the setpoint at servo rate, before the loop and the feed-forward; none if absent.
    pub setpoint_filter: Option<SetpointFilter>,
    /// Half-width of the interval in which the true gains lie, as a fraction of the stated ones, 0.1 = 10 %. Without measured
    /// motor current, transformers leave the joint a part of the servo's damping that grows with it. `opspace identify` writes it.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "0.05; 0.3 if the servo is listed in `assumed`")))]
    pub gain_uncertainty: Option<Fraction>,
}

/// Differentiated quantity of a PID servo.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DerivativeOf {
    /// Measured position: a step of the setpoint causes no derivative kick.
    #[default]
    Position,
    /// Position error.
    Error,
}

impl ServoStructure for PidServo {
    /// PID: `τ = K e + D w + i`, with w the filtered rate of e or of −y, and `i ← i + Ki T_s e`. With feed-forward, τ also
    /// has the setpoint's velocity and acceleration.
    fn law(&self, period_s: f64) -> Result<ServoLaw, ServoError> {
        let feed_forward = self.velocity_feed_forward.get();
        if self.derivative_of == DerivativeOf::Error && feed_forward > 0.0 {
            return Err(ServoError::FeedForwardTwice);
        }
        let gain = self.integral_nm_per_rad_s.get();
        let first = if gain == 0.0 { SETPOINT_BEFORE } else { 3 };
        let path = SetpointPath::new(self.setpoint(), first, period_s);
        let error = path.setpoint - Form::POSITION;
        let differentiated = match self.derivative_of {
            DerivativeOf::Position => Form::POSITION * -1.0,
            DerivativeOf::Error => error,
        };
        let change = differentiated - Form::memory(1);
        let damping = self.damping_nms_per_rad.get();
        let rate = match self.derivative_filter_hz {
            Some(filter_hz) => filtered_rate(Form::memory(0), change, filter_hz.get(), period_s),
            None if damping == 0.0 => Form::default(),
            None => return Err(ServoError::UnfilteredDerivative),
        };
        let torque = error * self.stiffness_nm_per_rad.get() + rate * damping;
        let torque = path.add_velocity(torque, damping);
        if gain == 0.0 {
            return Ok(ServoLaw::with_path(&[rate, differentiated], torque, &path));
        }
        let integral = Form::memory(2) + error * (gain * period_s);
        Ok(ServoLaw::with_path(&[rate, differentiated, integral], torque + integral, &path))
    }

    fn gains(&self, _period_s: f64) -> ServoGains {
        ServoGains { stiffness: self.stiffness_nm_per_rad.get(), damping: self.damping_nms_per_rad.get() }
    }

    fn setpoint(&self) -> SetpointParameters {
        SetpointParameters {
            filter: self.setpoint_filter,
            velocity_feed_forward: self.velocity_feed_forward.get(),
            acceleration_feed_forward_kg_m2: self.acceleration_feed_forward_kg_m2.get(),
        }
    }

    fn has_two_gains(&self) -> bool {
        self.integral_nm_per_rad_s.get() == 0.0
            && self.derivative_of == DerivativeOf::Position
            && self.damping_nms_per_rad.get() > 0.0
    }

    fn lead_s(&self) -> f64 {
        match self.derivative_of {
            DerivativeOf::Position => self.damping_nms_per_rad.get() / self.stiffness_nm_per_rad.get(),
            DerivativeOf::Error => 0.0,
        }
    }

    fn gain_uncertainty(&self) -> Option<f64> {
        self.gain_uncertainty.map(Fraction::get)
    }

    /// The worst case is a stiffness at the upper end and a damping at the lower end of their intervals. The derivative of an
    /// error does not oppose a constant velocity.
    fn remaining_damping(&self, gain_uncertainty: f64) -> RemainingDamping {
        let not_fed_forward = match self.derivative_of {
            DerivativeOf::Position => 1.0 - self.velocity_feed_forward.get(),
            DerivativeOf::Error => 0.0,
        };
        let opposing = not_fed_forward * self.damping_nms_per_rad.get();
        RemainingDamping::new(
            2.0 * opposing * gain_uncertainty / (1.0 + gain_uncertainty),
            opposing,
            gain_uncertainty,
        )
    }

    fn scale(&mut self, kp: f64, kv: f64) {
        self.stiffness_nm_per_rad = times(self.stiffness_nm_per_rad, kp * kv);
        self.damping_nms_per_rad = times_or_zero(self.damping_nms_per_rad, kv);
        self.integral_nm_per_rad_s = times_or_zero(self.integral_nm_per_rad_s, kp * kv);
    }

    fn velocity_filter_hz(&mut self) -> Option<&mut Positive> {
        self.derivative_filter_hz.as_mut()
    }

    fn identified(&self) -> Result<IdentifiedKeys, &'static str> {
        if self.integral_nm_per_rad_s.get() != 0.0 || self.derivative_of != DerivativeOf::Position {
            return Err("a PID servo with an integral, or with the derivative of the error");
        }
        Ok(|found| {
            [
                ("stiffness_nm_per_rad", found.kp_per_s * found.kv_nms_per_rad),
                ("damping_nms_per_rad", found.kv_nms_per_rad),
                ("derivative_filter_hz", found.filter_hz),
            ]
        })
    }
}
