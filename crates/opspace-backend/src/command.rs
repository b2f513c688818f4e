//! Commands to a robot.

/// The quantity that a command sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandKind {
    /// Joint torques, Nm (forces of prismatic joints, N).
    Torque,
    /// Joint positions, rad or m.
    Position,
}
