//! Response of a drive with its transformer to a desired torque in one cycle: how late and how spread the torque is, and how far
//! setpoints move.

use crate::drive_timing::DriveTiming;
use crate::moving_joint::{MovingJoint, SampledDrive};
use crate::servo_law::ServoLaw;

/// Desired torque, Nm (N): far below all limits.
const IMPULSE: f64 = 1e-3;

/// Time over which the response is computed, in addition to the delay, s.
const DURATION_S: f64 = 0.3;

/// Mean torque, relative to the desired one, below which the end of the response is left out.
const NEGLIGIBLE: f64 = 1e-4;

/// Response to a desired torque that is asked for in the first cycle alone, for a joint at rest. Empty if a value is not finite.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImpulseResponse {
    /// Mean torques of successive interface intervals, relative to the desired torque. Their sum is 1 if the transformer inverts
    /// the drive's law.
    pub torque: Vec<f64>,
    /// Setpoints of successive cycles relative to that at rest, per unit of the desired torque, rad/Nm (m/N).
    pub setpoint: Vec<f64>,
}

impl ImpulseResponse {
    /// Computes the response of the drive with this `law`.
    #[must_use]
    pub fn new(arm: &mut MovingJoint<'_>, law: ServoLaw, timing: DriveTiming) -> Self {
        let (position, holding) = (arm.position(), arm.holding_torque());
        let mut drive = SampledDrive::new(law, timing, position, holding);
        let at_rest = law.rest(position, holding).1;
        let (mut mean_torque, mut desired) = (holding, IMPULSE);
        let delay_cycles = (timing.delay / timing.servo_ticks_per_cycle) as usize;
        let cycles = (DURATION_S / timing.period_s()).ceil().max(8.0) as usize + delay_cycles;
        let mut response = Self { torque: Vec::with_capacity(cycles), setpoint: Vec::with_capacity(cycles) };
        for _ in 0..cycles {
            let setpoint = arm.cycle(position, mean_torque, |_| desired);
            for _ in 0..timing.servo_ticks_per_cycle {
                drive.step(setpoint, position);
            }
            mean_torque = drive.end_cycle(setpoint);
            response.torque.push((mean_torque - holding) / IMPULSE);
            response.setpoint.push((setpoint - at_rest) / IMPULSE);
            desired = 0.0;
        }
        if response.torque.iter().chain(&response.setpoint).any(|value| !value.is_finite()) {
            return Self::default();
        }
        let last = response.torque.iter().rposition(|torque| torque.abs() > NEGLIGIBLE);
        response.torque.truncate(last.map_or(0, |last| last + 1));
        response
    }
}
