//! Watchdogs of motor torque, power and oscillation of a position or velocity robot: they compare motor torques with the torques
//! for which the setpoints were computed.
//!
//! A servo with wrong nominal gains, or a setpoint in a wrong unit, produces other torques than desired and may
//! accelerate its joint. Two means with the time constant [`MEMORY_S`] are bounded for each joint; the first one is
//! the absolute value of the mean, not the mean of absolute values:
//!
//! ```text
//! |τ_motor − τ_desired|        and        (τ_motor − τ_desired) q̇
//! ```
//!
//! A transformer that knows the motion of its joint late makes the drive add an inertia m to the joint. In brisk motion, it takes
//! and returns kinetic energy, which a correction by current returns late. The bound of the power is larger by as much as this
//! energy changed within the time constant: the largest of `|m q̇²/2 − mean|`, which decays with it, over [`MEMORY_S`].
//!
//! In these means, the halves of an oscillation cancel. A third quantity is the rms of the deviation above 15 Hz, by a high pass
//! of fourth order, over 0.4 s. It is a fault if it exceeds its bound for longer than an impact lasts. Interfaces of 30 Hz or less sample no
//! frequency above 15 Hz: there it is not observed.

use crate::fault::Fault;
use crate::oscillation_detector::OscillationDetector;
use nalgebra::DVector;
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Time constant of the means, s: short compared with the time in which an arm moves far, long compared with torque
/// ripple within an interface cycle.
pub const MEMORY_S: f64 = 0.05;

/// Bounds of the watchdogs. Very large values disable them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct WatchdogParameters {
    /// Largest mean difference between motor torque and desired torque, as a fraction of the joint's torque limit.
    pub torque_deviation_share: Positive,
    /// Largest mean motor power in excess of the desired power, as a fraction of the joint's torque limit times its
    /// speed limit.
    pub surplus_power_share: Positive,
    /// Largest rms difference between motor torque and desired torque above 15 Hz, if it lasts, as a fraction of the joint's
    /// torque limit.
    pub torque_oscillation_share: Positive,
}

impl Default for WatchdogParameters {
    fn default() -> Self {
        Self {
            // Twice the largest deviation of the paper's transformer in any task of this project.
            torque_deviation_share: Positive::literal(0.6),
            // Eight times the power with nominal servos, or with an error that measured current corrects. A servo with a kp 30 %
            // above the nominal one reaches it within 0.1 to 0.3 s.
            surplus_power_share: Positive::literal(0.04),
            // 1.4 times the largest rms in 1000 brisk motions to random goals, on elastic gears too, and three times that of any
            // task of this project. Interfaces of 250 and 125 Hz with a cycle of delay oscillate on elastic gears at 0.2 to 0.5.
            torque_oscillation_share: Positive::literal(0.15),
        }
    }
}

/// Watchdog of motor torque, power and oscillation, updated every cycle; allocates nothing.
#[derive(Clone, Debug)]
pub struct Watchdog {
    gain: f64,
    torque_limits: DVector<f64>,
    power_limits: DVector<f64>,
    deviation: DVector<f64>,
    power: DVector<f64>,
    added_inertia: DVector<f64>,
    /// Mean kinetic energy of the added inertia (n; J).
    added_energy: DVector<f64>,
    /// Energy that the added inertia took or returned within the time constant (n; J).
    exchanged: DVector<f64>,
    oscillation: OscillationDetector,
}

impl Watchdog {
    /// Returns a watchdog for joints with these limits of torque (n; Nm, N) and speed (n; rad/s, m/s) and with drives that add
    /// these inertias (n; kg m², kg; none if empty), updated every `period_s` (s).
    #[must_use]
    pub fn new(
        parameters: &WatchdogParameters,
        torque_limits: &[f64],
        speed_limits: &[f64],
        added_inertia: &[f64],
        period_s: f64,
    ) -> Self {
        let n = torque_limits.len();
        let (deviation, power) =
            (parameters.torque_deviation_share.get(), parameters.surplus_power_share.get());
        Self {
            gain: 1.0 - (-period_s / MEMORY_S).exp(),
            torque_limits: DVector::from_fn(n, |i, _| deviation * torque_limits[i]),
            power_limits: DVector::from_fn(n, |i, _| power * torque_limits[i] * speed_limits[i]),
            deviation: DVector::zeros(n),
            power: DVector::zeros(n),
            added_inertia: DVector::from_fn(n, |i, _| added_inertia.get(i).copied().unwrap_or(0.0)),
            added_energy: DVector::zeros(n),
            exchanged: DVector::zeros(n),
            oscillation: OscillationDetector::new(
                parameters.torque_oscillation_share.get(),
                torque_limits,
                period_s,
            ),
        }
    }

    /// Clears the means.
    pub fn reset(&mut self) {
        self.deviation.fill(0.0);
        self.power.fill(0.0);
        self.added_energy.fill(0.0);
        self.exchanged.fill(0.0);
        self.oscillation.reset();
    }

    /// Updates the means with the motor torques since the last cycle and the desired torques (each n; Nm, N), and the
    /// joint velocities (n; rad/s, m/s).
    ///
    /// # Errors
    /// Fault of the first joint beyond a bound.
    pub fn check(
        &mut self,
        motor_torque: &DVector<f64>,
        desired: &DVector<f64>,
        dq: &DVector<f64>,
    ) -> Result<(), Fault> {
        for joint in 0..dq.len() {
            let more = motor_torque[joint] - desired[joint];
            self.deviation[joint] += self.gain * (more - self.deviation[joint]);
            self.power[joint] += self.gain * (more * dq[joint] - self.power[joint]);
            let (deviation, limit) = (self.deviation[joint], self.torque_limits[joint]);
            if deviation.abs() > limit {
                return Err(Fault::TorqueDeviation { joint, deviation, limit });
            }
            let energy = 0.5 * self.added_inertia[joint] * dq[joint] * dq[joint];
            self.added_energy[joint] += self.gain * (energy - self.added_energy[joint]);
            let change = (energy - self.added_energy[joint]).abs();
            self.exchanged[joint] = change.max((1.0 - self.gain) * self.exchanged[joint]);
            let limit = self.power_limits[joint] + self.exchanged[joint] / MEMORY_S;
            let power = self.power[joint];
            if power > limit {
                return Err(Fault::ExcessPower { joint, power, limit });
            }
        }
        self.oscillation.check(motor_torque, desired)
    }
}
