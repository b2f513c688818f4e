//! What a robot declares of itself, so that nobody guesses.

use opspace_backend::{CommandKind, GravityBy, Measured, MissedCycle, Setpoints};
use opspace_model::FrameId;
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
    /// What the drive does when no set-point comes in time.
    pub on_missed_cycle: MissedCycle,
    /// Who carries the robot's weight.
    pub gravity_by: GravityBy,
    /// What the robot measures.
    pub measures: Vec<Measured>,
}

/// What a robot takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CommandParameter {
    /// Joint positions.
    Position,
    /// Joint torques.
    Torque,
}

/// A force sensor: where it sits and what its axes are.
#[derive(Clone, Debug)]
pub struct ForceSensor {
    /// Its name in robot.toml.
    pub name: String,
    /// The frame at whose origin, and in whose axes, it measures.
    pub frame: FrameId,
}

/// What a backend declares of its robot.
#[derive(Clone, Debug)]
pub struct Facts {
    /// What the robot itself takes: also what a [`Position`](CommandKind::Position) command needs.
    pub command: CommandKind,
    /// Time between two interface ticks, s.
    pub period_s: f64,
    /// What the drives do with a set-point until the next one comes.
    pub set_points: Setpoints,
    /// Who carries the weight.
    pub gravity_by: GravityBy,
    /// What happens on a missed cycle.
    pub on_missed_cycle: MissedCycle,
    /// Whether motor torque is measured.
    pub motor_torque: bool,
    /// The force sensors, in the order of [`Measurement::wrenches`](opspace_control::Measurement::wrenches).
    pub sensors: Vec<ForceSensor>,
}
