//! Properties that a robot declares of itself and its interface.

use crate::command::CommandKind;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
#[cfg(feature = "serde")]
use serde::Deserialize;

/// Properties of a robot and its interface. Compared with robot.toml before a run; a contradiction is an error that
/// names both.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Capabilities {
    /// Joint names, in the order of every array (n).
    pub joints: Vec<String>,
    /// The kind of command for which the robot is opened.
    pub command: CommandKind,
    /// Time between two interface cycles, s.
    pub period_s: f64,
    /// Behaviour of the drives between two setpoints.
    pub setpoints: Setpoints,
    /// The part that compensates gravity.
    pub gravity_compensated_by: GravityCompensation,
    /// Behaviour of the drives in a cycle in which no command arrives.
    pub on_missed_cycle: MissedCycle,
    /// Presence of joint velocities in samples.
    pub measures_velocity: bool,
    /// Presence of motor torques in samples.
    pub measures_motor_torque: bool,
    /// Presence of joint torques in samples.
    pub measures_joint_torque: bool,
    /// Presence of a status in samples.
    pub reports_status: bool,
    /// The force sensors, in the order of [`Sample::wrenches`](crate::Sample::wrenches).
    pub force_sensors: Vec<ForceSensor>,
    /// Presence of brakes, which hold the robot when no controller commands it. Without them its servos do.
    pub has_brakes: bool,
    /// Simulated or real.
    pub world: World,
}

impl Capabilities {
    /// A real robot that measures joint positions only, holds its setpoints, and has its gravity compensated by the
    /// controller. A torque robot has brakes.
    #[must_use]
    pub fn new<S: Into<String>>(
        joints: impl IntoIterator<Item = S>,
        command: CommandKind,
        period_s: f64,
    ) -> Self {
        Self {
            joints: joints.into_iter().map(Into::into).collect(),
            command,
            period_s,
            setpoints: Setpoints::Held,
            gravity_compensated_by: GravityCompensation::Controller,
            on_missed_cycle: MissedCycle::of(command),
            measures_velocity: false,
            measures_motor_torque: false,
            measures_joint_torque: false,
            reports_status: false,
            force_sensors: Vec::new(),
            has_brakes: command == CommandKind::Torque,
            world: World::Real,
        }
    }

    /// Adds measured quantities, besides positions.
    #[must_use]
    pub fn measuring(mut self, measured: &[Measured]) -> Self {
        for quantity in measured {
            match quantity {
                Measured::Position => {}
                Measured::Velocity => self.measures_velocity = true,
                Measured::MotorCurrent => self.measures_motor_torque = true,
                Measured::JointTorque => self.measures_joint_torque = true,
            }
        }
        self
    }

    /// Adds a force sensor.
    #[must_use]
    pub fn with_force_sensor(mut self, name: impl Into<String>, frame: impl Into<String>) -> Self {
        self.force_sensors.push(ForceSensor { name: name.into(), frame: frame.into() });
        self
    }

    /// Sets the behaviour between two setpoints.
    #[must_use]
    pub fn with_setpoints(self, setpoints: Setpoints) -> Self {
        Self { setpoints, ..self }
    }

    /// Sets the part that compensates gravity.
    #[must_use]
    pub fn with_gravity_compensated_by(self, gravity_compensated_by: GravityCompensation) -> Self {
        Self { gravity_compensated_by, ..self }
    }

    /// Sets the presence of brakes.
    #[must_use]
    pub fn with_brakes(self, has_brakes: bool) -> Self {
        Self { has_brakes, ..self }
    }

    /// Adds a status to each sample.
    #[must_use]
    pub fn with_status(self) -> Self {
        Self { reports_status: true, ..self }
    }

    /// Marks the robot as simulated.
    #[must_use]
    pub fn simulated(self) -> Self {
        Self { world: World::Simulated, ..self }
    }
}

/// A force sensor: its axes are those of the frame, its reading is about the frame's origin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ForceSensor {
    /// Its name in robot.toml.
    pub name: String,
    /// The name of its frame in the URDF.
    pub frame: String,
}

/// World that a robot belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum World {
    /// In a simulation or a log.
    Simulated,
    /// Real: options that exist for comparison only are refused, and a run starts where the robot is.
    Real,
}

/// Behaviour of the drives between two setpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum Setpoints {
    /// A setpoint is held until the next one.
    Held,
    /// A setpoint is approached in equal steps, one at each servo tick, and reached when the next one acts.
    Interpolated,
}

impl Setpoints {
    /// The setpoint that a drive uses `age` servo ticks after `new` came in force, `before` until then, at `ratio`
    /// servo ticks per interface cycle.
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

/// Behaviour of the drives in a cycle in which no command arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum MissedCycle {
    /// The last setpoint is held: a position robot comes to a stop there, a velocity robot keeps its velocity.
    HoldLast,
    /// The last torque is held.
    HoldTorque,
}

impl MissedCycle {
    /// The behaviour of robots that take such commands.
    #[must_use]
    pub fn of(command: CommandKind) -> Self {
        match command {
            CommandKind::Position | CommandKind::Velocity => Self::HoldLast,
            CommandKind::Torque => Self::HoldTorque,
        }
    }
}

/// The part that compensates gravity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum GravityCompensation {
    /// The controller: its torques include gravity.
    Controller,
    /// The robot: it adds gravity's torque to every command.
    Robot,
}

/// A quantity that a robot measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[non_exhaustive]
pub enum Measured {
    /// Joint positions.
    Position,
    /// Joint velocities.
    Velocity,
    /// Motor current, given as torque at the joint.
    MotorCurrent,
    /// Torques at the joints.
    JointTorque,
}
