//! Any linear servo of the position error: torque over position error.

use crate::polynomial::value;
use crate::servo_gains::ServoGains;
use crate::servo_law::{Form, MAX_ORDER, ServoError, ServoLaw};
use crate::servo_structure::{IdentifiedKeys, ServoStructure};
use nalgebra::Complex;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Frequency, as a fraction of the servo rate, at which the gains of a transfer function are evaluated: above most
/// integrals, below most filters.
const GAINS_AT: f64 = 0.01;

/// Torque (Nm, N) over position error (rad, m) at servo rate:
/// `(b₀ + b₁ z⁻¹ + …)/(a₀ + a₁ z⁻¹ + …)`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TransferFunctionServo {
    /// b₀, b₁, …
    pub numerator: Vec<f64>,
    /// a₀, a₁, …
    pub denominator: Vec<f64>,
}

impl TransferFunctionServo {
    /// Value of the transfer function for `delay` = z⁻¹.
    fn at(&self, delay: Complex<f64>) -> Complex<f64> {
        value(&self.numerator, delay) / value(&self.denominator, delay)
    }
}

impl ServoStructure for TransferFunctionServo {
    /// Transfer function in the transposed direct form.
    fn law(&self, _period_s: f64) -> Result<ServoLaw, ServoError> {
        let (b, a) = (&self.numerator, &self.denominator);
        let order = b.len().max(a.len()).saturating_sub(1);
        if order > MAX_ORDER {
            return Err(ServoError::Order { order });
        }
        let Some(&first) = a.first().filter(|first| **first != 0.0) else {
            return Err(ServoError::Improper);
        };
        if b.iter().all(|b| *b == 0.0) {
            return Err(ServoError::NoTorque);
        }
        let weight = |coefficients: &[f64], i: usize| coefficients.get(i).map_or(0.0, |c| c / first);
        let shifted = |i: usize| if i < order { Form::memory(i) } else { Form::default() };
        let error = Form::SET_POINT - Form::POSITION;
        let torque = error * weight(b, 0) + shifted(0);
        let next: Vec<Form> =
            (1..=order).map(|i| error * weight(b, i) - torque * weight(a, i) + shifted(i)).collect();
        Ok(ServoLaw::of(&next, torque))
    }

    fn gains(&self, period_s: f64) -> ServoGains {
        let delay = Complex::from_polar(1.0, -TAU * GAINS_AT);
        let value = self.at(delay);
        ServoGains { stiffness: value.re.abs(), damping: (value.im * period_s / (TAU * GAINS_AT)).abs() }
    }

    fn scale(&mut self, kp: f64, kv: f64) {
        self.numerator.iter_mut().for_each(|b| *b = *b * kp * kv);
    }

    fn identified(&self) -> Result<IdentifiedKeys, &'static str> {
        Err("a transfer function")
    }
}
