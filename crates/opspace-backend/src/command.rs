//! Commands to a robot.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
#[cfg(feature = "serde")]
use serde::Deserialize;

/// The quantity that a command sets, by which robots are classified too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum CommandKind {
    /// Joint positions, rad or m.
    Position,
    /// Joint velocities, rad/s or m/s.
    Velocity,
    /// Joint torques, Nm (forces of prismatic joints, N).
    Torque,
}

impl CommandKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Position, Self::Velocity, Self::Torque];

    /// Its name in files, tables and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Velocity => "velocity",
            Self::Position => "position",
        }
    }

    /// SI unit of a revolute joint's command.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Torque => "Nm",
            Self::Velocity => "rad/s",
            Self::Position => "rad",
        }
    }
}

/// A command for all n joints: absolute values, in force until the next command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command<'a> {
    /// Torques that the motors are to produce at the joints, Nm or N (n).
    Torque(&'a [f64]),
    /// Joint velocities, rad/s or m/s (n).
    Velocity(&'a [f64]),
    /// Joint positions, rad or m (n).
    Position(&'a [f64]),
    /// No controller commands now: the robot stays where it is. A position robot keeps its last setpoint, a velocity
    /// robot stops its joints, a torque robot brakes or uses its own hold. The next command ends it.
    Hold,
}

impl<'a> Command<'a> {
    /// A command of that kind.
    #[must_use]
    pub fn new(kind: CommandKind, values: &'a [f64]) -> Self {
        match kind {
            CommandKind::Torque => Self::Torque(values),
            CommandKind::Velocity => Self::Velocity(values),
            CommandKind::Position => Self::Position(values),
        }
    }

    /// The quantity that it sets; `None` for [`Hold`](Self::Hold).
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
