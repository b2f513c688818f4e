//! `[interface]` of robot.toml: the commands that a robot accepts and the quantities that it measures.

use opspace_backend::{CommandKind, GravityCompensation, Measured, MissedCycle, Setpoints, StopMethod};
use opspace_transformer::Gears;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Table `[interface]` of robot.toml.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct InterfaceParameters {
    /// Command accepted by the robot: `position`, `velocity` or `torque`.
    pub command: CommandKind,
    /// Behaviour of the drive between two setpoints: it holds the last one or interpolates.
    #[cfg_attr(feature = "schema", schemars(with = "Option<Setpoints>", extend("x-default" = "`held` for torque robots, required for others")))]
    pub setpoints: Setpoints,
    /// Behaviour of the drives when a command is missed: `hold-last`, as position and velocity robots do, or
    /// `hold-torque`, as torque robots do.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "depends on `command`")))]
    pub on_missed_cycle: Option<MissedCycle>,
    /// Way in which a robot that moves is stopped: by `setpoints` that come to rest within their limits, as position and velocity
    /// robots are, or by the stop of the `robot` itself, as torque robots are.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "depends on `command`")))]
    pub on_stop: Option<StopMethod>,
    /// Compensation of the robot's weight: by the robot itself or by the controller.
    pub gravity_compensated_by: GravityCompensation,
    /// Quantities measured by the robot.
    #[cfg_attr(feature = "schema", schemars(extend("contains" = { "const": "position" })))]
    pub measured: Vec<Measured>,
    /// True if a velocity robot has brakes that hold it when no controller commands it.
    #[serde(default)]
    pub brakes: bool,
    /// Gears between motors and links: `rigid` if each motor with its link is known to resonate above six times the
    /// bandwidth of its velocity loop, `elastic` otherwise and if unknown. With `rigid` the default transformer emulates
    /// the arm, which makes elastic gears oscillate, and a torque robot estimates velocities with a model of the rigid arm. A joint with `gear_stiffness_nm_per_rad` makes the robot elastic.
    #[serde(default)]
    pub gears: Gears,
}
