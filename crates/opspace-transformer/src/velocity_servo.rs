//! Velocity loop, for a robot that accepts velocities.

use crate::servo_gains::ServoGains;
use crate::servo_law::{Form, ServoError, ServoLaw, filtered_rate};
use crate::servo_structure::{IdentifiedKeys, ServoStructure, times, times_or_zero};
use opspace_backend::CommandKind;
use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// `τ = kv (q̇_d − q̇) + ki ∫ (q̇_d − q̇)`, with q̇ from a filtered finite difference.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = crate::optional_keys::with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct VelocityServo {
    /// Gain kv on the velocity error, Nms/rad (Ns/m).
    pub kv_nms_per_rad: Positive,
    /// Gain ki on the integral of the velocity error, Nm/rad (N/m).
    #[serde(default)]
    pub ki_nm_per_rad: NonNegative,
    /// Cut-off frequency of the low-pass filter on the finite difference, Hz.
    pub velocity_filter_hz: Positive,
}

impl ServoStructure for VelocityServo {
    fn takes(&self) -> CommandKind {
        CommandKind::Velocity
    }

    /// Velocity loop: `w ← w + a ((y − y₋)/T_s − w)`, `e = q̇_d − w`, `i ← i + ki T_s e`, `τ = kv e + i`.
    fn law(&self, period_s: f64) -> Result<ServoLaw, ServoError> {
        let change = Form::POSITION - Form::memory(1);
        let rate = filtered_rate(Form::memory(0), change, self.velocity_filter_hz.get(), period_s);
        let error = Form::SET_POINT - rate;
        let torque = error * self.kv_nms_per_rad.get();
        let gain = self.ki_nm_per_rad.get();
        if gain == 0.0 {
            return Ok(ServoLaw::of(&[rate, Form::POSITION], torque));
        }
        let integral = Form::memory(2) + error * (gain * period_s);
        Ok(ServoLaw::of(&[rate, Form::POSITION, integral], torque + integral))
    }

    fn gains(&self, _period_s: f64) -> ServoGains {
        ServoGains { stiffness: 0.0, damping: self.kv_nms_per_rad.get() }
    }

    fn scale(&mut self, _kp: f64, kv: f64) {
        self.kv_nms_per_rad = times(self.kv_nms_per_rad, kv);
        self.ki_nm_per_rad = times_or_zero(self.ki_nm_per_rad, kv);
    }

    fn velocity_filter_hz(&mut self) -> Option<&mut Positive> {
        Some(&mut self.velocity_filter_hz)
    }

    fn identified(&self) -> Result<IdentifiedKeys, &'static str> {
        Err("a velocity servo")
    }
}
