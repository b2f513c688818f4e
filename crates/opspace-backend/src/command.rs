//! Commands to a robot.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
#[cfg(feature = "serde")]
use serde::Deserialize;

/// Quantity that a command sets. Robots are classified by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum CommandKind {
    /// Joint positions, rad or m.
    Position,
    /// Joint velocities, rad/s or m/s.
    Velocity,
    /// Joint torques, Nm, or forces of prismatic joints, N.
    Torque,
}

impl CommandKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Position, Self::Velocity, Self::Torque];

    /// Name in files, tables and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Velocity => "velocity",
            Self::Position => "position",
        }
    }

    /// SI unit of the command for a revolute joint.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Torque => "Nm",
            Self::Velocity => "rad/s",
            Self::Position => "rad",
        }
    }
}

/// A command for all n joints. The values are absolute and remain in effect until the next command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command<'a> {
    /// Desired motor torques at the joints, Nm or N (n).
    Torque(&'a [f64]),
    /// Joint velocities, rad/s or m/s (n).
    Velocity(&'a [f64]),
    /// Joint positions, rad or m (n).
    Position(&'a [f64]),
    /// No controller is active: the robot stays where it is. A position-controlled robot keeps its last setpoint, a
    /// velocity-controlled robot stops its joints, and a torque-controlled robot brakes or uses its internal position
    /// hold. The next command ends the hold.
    Hold,
}

impl<'a> Command<'a> {
    /// Returns a command of the given kind.
    #[must_use]
    pub fn new(kind: CommandKind, values: &'a [f64]) -> Self {
        match kind {
            CommandKind::Torque => Self::Torque(values),
            CommandKind::Velocity => Self::Velocity(values),
            CommandKind::Position => Self::Position(values),
        }
    }

    /// Returns the kind of the command; `None` for [`Hold`](Self::Hold).
    #[must_use]
    pub fn kind(&self) -> Option<CommandKind> {
        match self {
            Self::Torque(_) => Some(CommandKind::Torque),
            Self::Velocity(_) => Some(CommandKind::Velocity),
            Self::Position(_) => Some(CommandKind::Position),
            Self::Hold => None,
        }
    }
}
