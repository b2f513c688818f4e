//! Properties of a robot and its interface, as its driver declares them.

use crate::command::CommandKind;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
#[cfg(feature = "serde")]
use serde::Deserialize;

/// Properties of a robot and its interface. They are compared with robot.toml before a run; each contradiction is an
/// error that names both values.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Capabilities {
    /// Joint names (n), in the order of all joint arrays.
    pub joints: Vec<String>,
    /// Kind of command for which the robot is opened.
    pub command: CommandKind,
    /// Time between two interface cycles, s.
    pub period_s: f64,
    /// Behaviour of the drives between two setpoints.
    pub setpoints: Setpoints,
    /// Component that compensates gravity: the controller or the robot.
    pub gravity_compensated_by: GravityCompensation,
    /// Behaviour of the drives in a cycle without a new command.
    pub on_missed_cycle: MissedCycle,
    /// Way in which a robot that moves is stopped.
    pub on_stop: StopMethod,
    /// True if samples contain joint velocities.
    pub measures_velocity: bool,
    /// True if samples contain motor torques.
    pub measures_motor_torque: bool,
    /// True if samples contain joint torques.
    pub measures_joint_torque: bool,
    /// True if samples contain a status.
    pub reports_status: bool,
    /// Force sensors, in the order of [`Sample::wrenches`](crate::Sample::wrenches).
    pub force_sensors: Vec<ForceSensor>,
    /// True if the robot has brakes that hold it when no controller commands it. A robot without brakes is held by its
    /// servos.
    pub has_brakes: bool,
    /// Limits that the device keeps by itself (n); empty if it reports none.
    pub joint_limits: Vec<DeviceLimits>,
    /// Simulated or real.
    pub world: World,
}

impl Capabilities {
    /// Returns the properties of a real robot that measures only joint positions, holds its setpoints between cycles,
    /// and relies on the controller for gravity compensation. It has brakes if it is torque-controlled.
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
            on_stop: StopMethod::of(command),
            measures_velocity: false,
            measures_motor_torque: false,
            measures_joint_torque: false,
            reports_status: false,
            force_sensors: Vec::new(),
            has_brakes: command == CommandKind::Torque,
            joint_limits: Vec::new(),
            world: World::Real,
        }
    }

    /// Adds measured quantities; positions are always measured.
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

    /// Sets the force sensors, for a driver those of its [`Settings`](crate::Settings).
    #[must_use]
    pub fn with_force_sensors(self, force_sensors: Vec<ForceSensor>) -> Self {
        Self { force_sensors, ..self }
    }

    /// Sets the behaviour of the drives between two setpoints.
    #[must_use]
    pub fn with_setpoints(self, setpoints: Setpoints) -> Self {
        Self { setpoints, ..self }
    }

    /// Sets the component that compensates gravity.
    #[must_use]
    pub fn with_gravity_compensated_by(self, gravity_compensated_by: GravityCompensation) -> Self {
        Self { gravity_compensated_by, ..self }
    }

    /// Sets the way in which the robot is stopped.
    #[must_use]
    pub fn with_on_stop(self, on_stop: StopMethod) -> Self {
        Self { on_stop, ..self }
    }

    /// Sets whether the robot has brakes.
    #[must_use]
    pub fn with_brakes(self, has_brakes: bool) -> Self {
        Self { has_brakes, ..self }
    }

    /// Sets the limits that the device keeps by itself (n). A limit of robot.toml above one of them is an error before a run.
    #[must_use]
    pub fn with_joint_limits(self, joint_limits: Vec<DeviceLimits>) -> Self {
        Self { joint_limits, ..self }
    }

    /// Declares that each sample contains a status.
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

/// Limits of one joint beyond which a device stops or clamps by itself. `None` is a limit that it does not report.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeviceLimits {
    /// Largest torque, Nm (N).
    pub torque_nm: Option<f64>,
    /// Largest speed, rad/s (m/s).
    pub velocity_rad_per_s: Option<f64>,
    /// Largest velocity of a setpoint, rad/s (m/s).
    pub setpoint_velocity_rad_per_s: Option<f64>,
    /// Largest acceleration of a setpoint, rad/s² (m/s²).
    pub setpoint_acceleration_rad_per_s2: Option<f64>,
    /// Largest jerk of a setpoint, rad/s³ (m/s³).
    pub setpoint_jerk_rad_per_s3: Option<f64>,
}

/// A force sensor. It measures the wrench in the axes of its frame, about the origin of that frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ForceSensor {
    /// Name of the sensor in robot.toml.
    pub name: String,
    /// Name of the sensor's frame in the URDF.
    pub frame: String,
}

/// Distinction between simulated and real robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum World {
    /// A robot in a simulation or a log.
    Simulated,
    /// A real robot. Options that exist for comparisons only are refused, and a run starts at the robot's current
    /// position.
    Real,
}

/// Behaviour of the drives between two setpoints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum Setpoints {
    /// A setpoint is held until the next one.
    Held,
    /// The drive interpolates linearly, one step per servo tick, and reaches each setpoint at the last tick before the
    /// next setpoint.
    Interpolated,
}

impl Setpoints {
    /// Returns the setpoint that a drive uses `age` servo ticks after setpoint `new` replaced `before`. `ratio` is the
    /// number of servo ticks per interface cycle.
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

/// Behaviour of the drives in a cycle without a new command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum MissedCycle {
    /// The last setpoint is held: a position-controlled robot stops there, a velocity-controlled robot keeps its
    /// velocity.
    HoldLast,
    /// The last torque is held.
    HoldTorque,
}

impl MissedCycle {
    /// Returns the usual behaviour of robots with this kind of command.
    #[must_use]
    pub fn of(command: CommandKind) -> Self {
        match command {
            CommandKind::Position | CommandKind::Velocity => Self::HoldLast,
            CommandKind::Torque => Self::HoldTorque,
        }
    }
}

/// Way in which a robot that moves is stopped: at the end of a run, on request and after a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[non_exhaustive]
pub enum StopMethod {
    /// Setpoints come to rest within the limits of `setpoint_limits`; then the robot's own stop follows. Those of a joint without
    /// such limits go, at its speed limit at most, to where they balance its weight, and its servo brakes it.
    Setpoints,
    /// No command follows: the robot's own stop brakes it.
    Robot,
}

impl StopMethod {
    /// Returns the usual way for robots with this kind of command.
    #[must_use]
    pub fn of(command: CommandKind) -> Self {
        match command {
            CommandKind::Position | CommandKind::Velocity => Self::Setpoints,
            CommandKind::Torque => Self::Robot,
        }
    }
}

/// Component that compensates gravity: the controller or the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(Deserialize), serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum GravityCompensation {
    /// The controller: its torque commands include the gravity torques.
    Controller,
    /// The robot: it adds the gravity torques to every command.
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
    /// Motor currents, converted to torques at the joints.
    MotorCurrent,
    /// Joint torques, measured by torque sensors.
    JointTorque,
}
