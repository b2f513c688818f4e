//! Known torques on the joints since the last sample, the input of the observers of external torques.

use nalgebra::DVector;
use opspace_backend::{Capabilities, CommandDelay, CommandsInForce, GravityCompensation};
use opspace_control::Measurement;
use opspace_model::Data;

/// Mean of τ_m + Cᵀ q̇ − g since the last sample, with the torques τ_m of the motors: measured, or else those that were
/// commanded.
#[derive(Clone, Debug)]
pub(crate) struct DrivingTorque {
    compensates_gravity: bool,
    /// Torques of the commands that act (n; Nm, N).
    commanded: CommandsInForce,
    /// Cᵀ q̇ − g at the last sample (n; Nm, N).
    rates: DVector<f64>,
    /// Mean torques of the motors since the last sample (n; Nm, N).
    motor: DVector<f64>,
    mean: DVector<f64>,
}

impl DrivingTorque {
    /// Returns the torques of `n` joints; a command acts after `command_delay_s` (s).
    pub(crate) fn new(n: usize, capabilities: &Capabilities, command_delay_s: f64) -> Self {
        let zero = DVector::zeros(n);
        Self {
            compensates_gravity: capabilities.gravity_compensated_by == GravityCompensation::Controller,
            commanded: CommandsInForce::new(n, CommandDelay::of_time(command_delay_s, capabilities.period_s)),
            rates: zero.clone(),
            motor: zero.clone(),
            mean: zero,
        }
    }

    /// Computes the mean since the last sample; `commanded` are the torques of the last command (n; Nm, N). After a hold the
    /// first mean has no meaning: there was no command.
    pub(crate) fn update(&mut self, data: &Data, measurement: &Measurement, commanded: &DVector<f64>) {
        if commanded.iter().all(|torque| torque.is_finite()) {
            self.commanded.push(commanded.as_slice());
        } else {
            self.commanded.clear();
        }
        for i in 0..commanded.len() {
            self.motor[i] = match &measurement.motor_torque {
                Some(measured) => measured[i],
                None => self.commanded.mean(i),
            };
            let gravity = if self.compensates_gravity { data.gravity[i] } else { 0.0 };
            let rate = data.kinetic_energy_gradient[i] - gravity;
            self.mean[i] = self.motor[i] + 0.5 * (self.rates[i] + rate);
            self.rates[i] = rate;
        }
    }

    /// Mean since the last sample (n; Nm, N).
    pub(crate) fn mean(&self) -> &DVector<f64> {
        &self.mean
    }

    /// Mean torques of the motors since the last sample (n; Nm, N).
    pub(crate) fn motor(&self) -> &DVector<f64> {
        &self.motor
    }
}
