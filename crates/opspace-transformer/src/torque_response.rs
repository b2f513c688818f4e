//! Response of a drive with its transformer to a desired torque: how late and how spread the torque is.

use crate::drive_timing::DriveTiming;
use crate::moving_joint::{MovingJoint, SampledDrive};
use crate::servo_law::ServoLaw;

/// Desired torque, Nm (N): far below all limits.
const IMPULSE: f64 = 1e-3;

/// Time over which the response is computed, s.
const DURATION_S: f64 = 0.3;

/// Mean torque, relative to the desired one, below which the end of the response is left out.
const NEGLIGIBLE: f64 = 1e-4;

/// Returns the mean torques of successive interface intervals, relative to a desired torque that is asked for in the first
/// cycle alone, for a joint at rest. Their sum is 1 if the transformer inverts the drive's `law`. Empty if the torques are not finite.
#[must_use]
pub fn torque_response(arm: &mut MovingJoint<'_>, law: ServoLaw, timing: DriveTiming) -> Vec<f64> {
    let (position, holding) = (arm.position(), arm.holding_torque());
    let mut drive = SampledDrive::new(law, timing, position, holding);
    let (mut mean_torque, mut desired) = (holding, IMPULSE);
    let cycles = (DURATION_S / timing.period_s()).ceil().max(8.0) as usize;
    let mut response = Vec::with_capacity(cycles);
    for _ in 0..cycles {
        let setpoint = arm.cycle(position, mean_torque, |_| desired);
        for _ in 0..timing.servo_ticks_per_cycle {
            drive.step(setpoint, position);
        }
        mean_torque = drive.end_cycle(setpoint);
        response.push((mean_torque - holding) / IMPULSE);
        desired = 0.0;
    }
    if response.iter().any(|torque| !torque.is_finite()) {
        return Vec::new();
    }
    let last = response.iter().rposition(|torque| torque.abs() > NEGLIGIBLE);
    response.truncate(last.map_or(0, |last| last + 1));
    response
}
