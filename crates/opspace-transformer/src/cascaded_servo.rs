//! Position loop around a velocity loop.

use crate::remaining_damping::RemainingDamping;
use crate::servo_gains::ServoGains;
use crate::servo_law::{
    Form, SETPOINT_BEFORE, ServoError, ServoLaw, SetpointParameters, SetpointPath, filtered_rate,
};
use crate::servo_structure::{IdentifiedKeys, ServoStructure, times};
use crate::setpoint_filter::SetpointFilter;
use opspace_backend::quantity::{Fraction, NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Equation (K9) of the paper: `τ = kv [kp (q_d − q) − q̇]`; optionally with an integral in the velocity loop.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = crate::optional_keys::with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct CascadedServo {
    /// Gain of the outer position loop, 1/s.
    pub kp_per_s: Positive,
    /// Gain of the inner velocity loop, Nms/rad (Ns/m).
    pub kv_nms_per_rad: Positive,
    /// Cut-off frequency of the servo's low-pass filter on its finite-difference velocity, Hz.
    pub velocity_filter_hz: Positive,
    /// Integral time of the velocity loop, s; no integral if absent.
    pub velocity_integral_time_s: Option<Positive>,
    /// Fraction of the setpoint's velocity that is fed forward to the velocity loop: `velocity_feed_forward (q_d −
    /// q_d₋)/T_s` is added to its setpoint, with q_d₋ of the servo tick before.
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

impl CascadedServo {
    /// Returns a cascade without an integral, feed-forward or setpoint filter.
    #[must_use]
    pub const fn new(kp_per_s: Positive, kv_nms_per_rad: Positive, velocity_filter_hz: Positive) -> Self {
        Self {
            kp_per_s,
            kv_nms_per_rad,
            velocity_filter_hz,
            velocity_integral_time_s: None,
            velocity_feed_forward: Fraction::literal(0.0),
            acceleration_feed_forward_kg_m2: NonNegative::literal(0.0),
            setpoint_filter: None,
            gain_uncertainty: None,
        }
    }
}

impl ServoStructure for CascadedServo {
    /// Cascade: `w ← w + a ((y − y₋)/T_s − w)`, `e = kp (q_d − y) − w`, `z ← z + e T_s/Ti`, `τ = kv (e + z)`. With
    /// feed-forward, e also has the setpoint's velocity and τ its acceleration.
    fn law(&self, period_s: f64) -> Result<ServoLaw, ServoError> {
        let (velocity, integral) = (Form::memory(0), Form::memory(2));
        let velocity = filtered_rate(
            velocity,
            Form::POSITION - Form::memory(1),
            self.velocity_filter_hz.get(),
            period_s,
        );
        let first = if self.velocity_integral_time_s.is_some() { 3 } else { SETPOINT_BEFORE };
        let path = SetpointPath::new(self.setpoint(), first, period_s);
        let error = (path.setpoint - Form::POSITION) * self.kp_per_s.get() - velocity;
        let error = path.add_velocity(error, 1.0);
        let kv = self.kv_nms_per_rad.get();
        Ok(match self.velocity_integral_time_s {
            None => ServoLaw::with_path(&[velocity, Form::POSITION], error * kv, &path),
            Some(time_s) => {
                let integral = integral + error * (period_s / time_s.get());
                ServoLaw::with_path(&[velocity, Form::POSITION, integral], (error + integral) * kv, &path)
            }
        })
    }

    fn gains(&self, _period_s: f64) -> ServoGains {
        let damping = self.kv_nms_per_rad.get();
        ServoGains { stiffness: damping * self.kp_per_s.get(), damping }
    }

    fn setpoint(&self) -> SetpointParameters {
        SetpointParameters {
            filter: self.setpoint_filter,
            velocity_feed_forward: self.velocity_feed_forward.get(),
            acceleration_feed_forward_kg_m2: self.acceleration_feed_forward_kg_m2.get(),
        }
    }

    fn has_two_gains(&self) -> bool {
        self.velocity_integral_time_s.is_none()
    }

    fn lead_s(&self) -> f64 {
        1.0 / self.kp_per_s.get()
    }

    fn gain_uncertainty(&self) -> Option<f64> {
        self.gain_uncertainty.map(Fraction::get)
    }

    /// kv scales the whole torque: only kp matters.
    fn remaining_damping(&self, gain_uncertainty: f64) -> RemainingDamping {
        let opposing = self.kv_nms_per_rad.get() * (1.0 - self.velocity_feed_forward.get());
        RemainingDamping::new(
            opposing * gain_uncertainty / (1.0 + gain_uncertainty),
            opposing,
            gain_uncertainty,
        )
    }

    fn scale(&mut self, kp: f64, kv: f64) {
        self.kp_per_s = times(self.kp_per_s, kp);
        self.kv_nms_per_rad = times(self.kv_nms_per_rad, kv);
    }

    fn velocity_filter_hz(&mut self) -> Option<&mut Positive> {
        Some(&mut self.velocity_filter_hz)
    }

    fn identified(&self) -> Result<IdentifiedKeys, &'static str> {
        match self.velocity_integral_time_s {
            None => Ok(|found| {
                [
                    ("kp_per_s", found.kp_per_s),
                    ("kv_nms_per_rad", found.kv_nms_per_rad),
                    ("velocity_filter_hz", found.filter_hz),
                ]
            }),
            Some(_) => Err("cascaded with an integral"),
        }
    }
}
