//! The faults that a simulated robot reports: codes and sentences.

use opspace_backend::{CommandKind, DeviceFault};

/// Code of [`diverged`].
pub const DIVERGED: u32 = 1;
/// Code of [`wrong_command`].
pub const WRONG_COMMAND: u32 = 2;
/// Code of [`wrong_length`].
pub const WRONG_LENGTH: u32 = 3;

/// The true state is not finite any more.
#[must_use]
pub fn diverged() -> DeviceFault {
    DeviceFault::new(DIVERGED, "the simulation diverged")
}

/// The command is not of the kind that the robot takes.
#[must_use]
pub fn wrong_command(takes: CommandKind) -> DeviceFault {
    let words = match takes {
        CommandKind::Torque => "the simulated robot accepts only joint torques",
        CommandKind::Velocity => "the simulated robot accepts only joint velocities",
        CommandKind::Position => "the simulated robot accepts only joint positions",
    };
    DeviceFault::new(WRONG_COMMAND, words)
}

/// The command does not have one value per joint.
#[must_use]
pub fn wrong_length() -> DeviceFault {
    DeviceFault::new(WRONG_LENGTH, "the command does not have one value per joint")
}
