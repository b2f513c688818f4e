//! What a robot declares of itself, so that nobody guesses.

use opspace_control::CommandKind;
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
    pub set_points: SetPoints,
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

/// What the drive does with a set-point until the next one comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SetPoints {
    /// It holds it.
    Held,
    /// It goes to it from the one before, a step at each servo tick, and is there when the next one acts.
    Interpolated,
}

impl SetPoints {
    /// What a drive takes for its set-point `age` servo ticks after `new` came in force, `before` until then; at `ratio`
    /// servo ticks per interface tick.
    #[must_use]
    pub fn at(self, before: f64, new: f64, age: u32, ratio: u32) -> f64 {
        match self {
            Self::Interpolated if age + 1 < ratio => {
                before + (new - before) * f64::from(age + 1) / f64::from(ratio)
            }
            _ => new,
        }
    }
}

/// What the drive does when no set-point comes in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MissedCycle {
    /// It holds the last one: a position robot comes to a stop there.
    HoldLast,
}

/// Who carries the robot's weight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GravityBy {
    /// The commanded torque must.
    Controller,
    /// The robot adds it to whatever it is commanded.
    Robot,
}

/// A quantity that the robot measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Measured {
    /// Joint positions.
    Position,
    /// Motor current, given as torque at the joint.
    MotorCurrent,
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
    pub set_points: SetPoints,
    /// Who carries the weight.
    pub gravity_by: GravityBy,
    /// What happens on a missed cycle.
    pub on_missed_cycle: MissedCycle,
    /// Whether motor torque is measured.
    pub motor_torque: bool,
    /// The force sensors, in the order of [`Measurement::wrenches`](opspace_control::Measurement::wrenches).
    pub sensors: Vec<ForceSensor>,
}
