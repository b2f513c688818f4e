//! Faults that a simulated robot reports: codes and messages.

use opspace_backend::{CommandKind, DeviceFault};
use opspace_transformer::SetpointLimit;

/// Code of [`diverged`].
pub const DIVERGED: u32 = 1;
/// Code of [`wrong_command`].
pub const WRONG_COMMAND: u32 = 2;
/// Code of [`wrong_length`].
pub const WRONG_LENGTH: u32 = 3;
/// Code of [`setpoint_limit`] and [`stopped`].
pub const SETPOINT_LIMIT: u32 = 4;

/// Returns the fault of a simulation whose true state is no longer finite.
#[must_use]
pub fn diverged() -> DeviceFault {
    DeviceFault::new(DIVERGED, "the simulation diverged")
}

/// Returns the fault of a command whose kind the robot does not accept.
#[must_use]
pub fn wrong_command(takes: CommandKind) -> DeviceFault {
    let words = match takes {
        CommandKind::Torque => "the simulated robot accepts only joint torques",
        CommandKind::Velocity => "the simulated robot accepts only joint velocities",
        CommandKind::Position => "the simulated robot accepts only joint positions",
    };
    DeviceFault::new(WRONG_COMMAND, words)
}

/// Returns the fault of a command that does not have one value per joint.
#[must_use]
pub fn wrong_length() -> DeviceFault {
    DeviceFault::new(WRONG_LENGTH, "the command does not have one value per joint")
}

/// Returns the fault of a drive that stops because the setpoint of its joint exceeds a limit. `unit` is that of the
/// joint's position.
#[must_use]
pub fn setpoint_limit(joint: &str, exceeded: SetpointLimit, limit: f64, unit: &str) -> DeviceFault {
    let per = match exceeded {
        SetpointLimit::Acceleration => "/s²",
        SetpointLimit::Jerk => "/s³",
        _ => "/s",
    };
    let quantity = exceeded.name();
    let words = format!(
        "the setpoint of joint '{joint}' exceeds the drive's {quantity} limit of {limit} {unit}{per}"
    );
    DeviceFault::new(SETPOINT_LIMIT, words)
}

/// Returns the fault of a robot that a setpoint beyond a limit has stopped before.
#[must_use]
pub fn stopped() -> DeviceFault {
    DeviceFault::new(SETPOINT_LIMIT, "a setpoint beyond a limit has stopped the drives")
}
