//! Timing of a drive and of its setpoints.

use opspace_backend::Setpoints;

/// Timing of a drive.
#[derive(Clone, Copy, Debug)]
pub struct DriveTiming {
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks per interface cycle.
    pub servo_ticks_per_cycle: u32,
    /// Delay until a setpoint acts, in servo ticks.
    pub delay: u32,
    /// Behaviour between two setpoints: hold or interpolate.
    pub setpoints: Setpoints,
}

impl DriveTiming {
    /// Time between two interface cycles, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        self.servo_period_s * f64::from(self.servo_ticks_per_cycle)
    }
}
