//! Watchdogs of the torque and power of a position robot's motors, against the torques for which its setpoints were
//! made.
//!
//! A servo with other gains than the nominal ones, or a setpoint in another unit, gives other torques than desired, and
//! may push its joint along. Two quantities are watched for each joint, as means with the time constant [`MEMORY_S`]:
//!
//! ```text
//! |τ_motor − τ_desired|        and        (τ_motor − τ_desired) q̇
//! ```

use crate::fault::Fault;
use nalgebra::DVector;
use opspace_backend::quantity::Positive;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Time constant of the means, s: short compared with the time that an arm needs to get away, long compared with the
/// period of torque ripple within an interface cycle.
pub const MEMORY_S: f64 = 0.05;

/// Bounds of the watchdogs. A bound of many times the limit is none.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct WatchdogParameters {
    /// Largest mean difference of motor torque and desired torque, as a fraction of the joint's torque limit.
    #[serde(default = "default_deviation")]
    pub torque_deviation_share: Positive,
    /// Largest mean power of the motor beyond the desired one, as a fraction of the joint's torque limit times
    /// its speed limit.
    #[serde(default = "default_power")]
    pub surplus_power_share: Positive,
}

impl Default for WatchdogParameters {
    fn default() -> Self {
        Self { torque_deviation_share: default_deviation(), surplus_power_share: default_power() }
    }
}

/// Default bound on the deviation: twice what the paper's transformer leaves on any task of this project.
const fn default_deviation() -> Positive {
    Positive::literal(0.6)
}

/// Default bound on the power: ten times that of a servo with its nominal parameters, or with an error that the
/// measured current corrects; a servo whose kp is 30 % higher reaches it within 0.1 to 0.3 s.
const fn default_power() -> Positive {
    Positive::literal(0.05)
}

/// Watchdog of motor torque and power, updated every cycle; allocates nothing.
#[derive(Clone, Debug)]
pub struct Watchdog {
    gain: f64,
    torque_limits: DVector<f64>,
    power_limits: DVector<f64>,
    deviation: DVector<f64>,
    power: DVector<f64>,
}

impl Watchdog {
    /// A watchdog for joints with these limits of torque (n; Nm, N) and speed (n; rad/s, m/s), updated every `period_s`
    /// (s).
    #[must_use]
    pub fn new(
        parameters: &WatchdogParameters,
        torque_limits: &[f64],
        speed_limits: &[f64],
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
        }
    }

    /// Clears the means.
    pub fn reset(&mut self) {
        self.deviation.fill(0.0);
        self.power.fill(0.0);
    }

    /// Updates the means with the torques of the motors since the last cycle and the desired ones (n each; Nm, N), and
    /// with the velocities of the joints (n; rad/s, m/s).
    ///
    /// # Errors
    /// The first joint beyond a bound.
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
            let (power, limit) = (self.power[joint], self.power_limits[joint]);
            if power > limit {
                return Err(Fault::ExcessPower { joint, power, limit });
            }
        }
        Ok(())
    }
}
