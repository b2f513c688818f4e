//! Properties that a robot declares of its interface.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
#[cfg(feature = "schema")]
use serde::Deserialize;

/// What the drive does with a set-point until the next one comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(Deserialize, JsonSchema), serde(rename_all = "kebab-case"))]
pub enum Setpoints {
    /// It holds it.
    Held,
    /// It goes to it from the one before, a step at each servo tick, and is there when the next one acts.
    Interpolated,
}

impl Setpoints {
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(Deserialize, JsonSchema), serde(rename_all = "kebab-case"))]
pub enum MissedCycle {
    /// It holds the last one: a position robot comes to a stop there.
    HoldLast,
}

/// Who carries the robot's weight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(Deserialize, JsonSchema), serde(rename_all = "kebab-case"))]
pub enum GravityBy {
    /// The commanded torque must.
    Controller,
    /// The robot adds it to whatever it is commanded.
    Robot,
}

/// A quantity that the robot measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(Deserialize, JsonSchema), serde(rename_all = "kebab-case"))]
pub enum Measured {
    /// Joint positions.
    Position,
    /// Motor current, given as torque at the joint.
    MotorCurrent,
}
