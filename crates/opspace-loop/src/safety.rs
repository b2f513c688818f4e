//! Safety parameters of a run: `[safety]` of robot.toml.

use crate::watchdog::WatchdogParameters;
use opspace_backend::quantity::NonNegative;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Safety parameters of a run: torque ramp, taring, joint limits, missed cycles and watchdogs.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SafetyParameters {
    /// Time over which torques ramp in, from the torques that hold the arm at rest, s.
    pub torque_ramp_s: NonNegative,
    /// Time at rest before the start during which force sensors are tared, s.
    #[cfg_attr(feature = "schema", schemars(extend("maximum" = 60)))]
    pub tare_s: NonNegative,
    /// Margin beyond the URDF's position limits; a measured position beyond it is a fault, rad (m).
    pub limit_margin_rad: NonNegative,
    /// Largest number of consecutive missed interface cycles over which control continues. After more, the robot is
    /// held, and control resumes when it stands still.
    pub max_missed_cycles: u32,
    /// Longest time without a sample, and longest time to come to rest afterwards, s. A longer time is a fault.
    pub max_dropout_s: NonNegative,
    /// Watchdogs of motor torque, power and oscillation, for a position or velocity robot with measured motor torque.
    pub watchdog: WatchdogParameters,
}

impl Default for SafetyParameters {
    fn default() -> Self {
        Self {
            torque_ramp_s: NonNegative::literal(0.2),
            tare_s: NonNegative::literal(0.2),
            limit_margin_rad: NonNegative::default(),
            max_missed_cycles: 3,
            max_dropout_s: NonNegative::literal(1.0),
            watchdog: WatchdogParameters::default(),
        }
    }
}
