//! Drives of one arm: those of a robot that accepts setpoints, or torques.

use crate::motors::Motors;
use crate::servo_drives::ServoDrives;
use crate::torque_drives::TorqueDrives;

/// Drives of one arm.
pub(crate) enum Drives {
    Servo(ServoDrives),
    Torque(TorqueDrives),
}

impl Drives {
    /// Enters the safe state. `q` is the true position (n; rad, m).
    pub fn stop(&mut self, motors: &mut Motors, q: &[f64]) {
        match self {
            Self::Servo(drives) => drives.stop(motors, q),
            Self::Torque(drives) => drives.stop(motors, q),
        }
    }

    /// Number of the command in effect; `None` while the robot holds itself without a command (servos or brakes).
    pub fn command_in_force(&self) -> Option<u64> {
        match self {
            Self::Servo(drives) => drives.command_in_force(),
            Self::Torque(drives) => drives.command_in_force(),
        }
    }

    /// Runs a servo tick with the links at `q` (n; rad, m).
    pub fn servo_tick(&mut self, motors: &mut Motors, q: &[f64], servo_tick: u64) {
        match self {
            Self::Servo(drives) => drives.servo_tick(motors, q, servo_tick),
            Self::Torque(drives) => drives.servo_tick(motors, q, servo_tick),
        }
    }
}
