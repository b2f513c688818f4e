//! `[interface]` of robot.toml: what a robot is declared to take and to measure.

use opspace_backend::{CommandKind, GravityCompensation, Measured, MissedCycle, Setpoints};
use schemars::JsonSchema;
use serde::Deserialize;

/// The `interface` of robot.toml.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InterfaceParameters {
    /// What the robot takes.
    pub command: CommandParameter,
    /// What the drive does with a set-point between two interface ticks.
    pub set_points: Setpoints,
    /// What the drives do where a command fails to come: `hold-last`, which is what position and velocity robots do, or
    /// `hold-torque`, which is what torque robots do.
    #[serde(default)]
    pub on_missed_cycle: Option<MissedCycle>,
    /// Who carries the robot's weight.
    pub gravity_by: GravityCompensation,
    /// What the robot measures.
    pub measures: Vec<Measured>,
    /// Whether a velocity robot has brakes that hold it when no controller commands it.
    #[serde(default)]
    pub brakes: bool,
}

/// What a robot takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CommandParameter {
    /// Joint positions.
    Position,
    /// Joint velocities.
    Velocity,
    /// Joint torques.
    Torque,
}

impl CommandParameter {
    /// The kind of command.
    #[must_use]
    pub fn kind(self) -> CommandKind {
        match self {
            Self::Position => CommandKind::Position,
            Self::Velocity => CommandKind::Velocity,
            Self::Torque => CommandKind::Torque,
        }
    }
}
