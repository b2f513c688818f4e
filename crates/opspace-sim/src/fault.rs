//! Faults that a simulated robot reports: codes and messages.

use opspace_backend::{CommandKind, DeviceFault};

/// Code of [`diverged`].
pub const DIVERGED: u32 = 1;
/// Code of [`wrong_command`].
pub const WRONG_COMMAND: u32 = 2;
/// Code of [`wrong_length`].
pub const WRONG_LENGTH: u32 = 3;

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
