//! Controller of a robot, as files name it.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Controller of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ControllerKind {
    /// Operational-space control: torques.
    Osc,
    /// Inverse kinematics: positions.
    Ik,
    /// Inverse kinematics with velocity lead and compensation of the gravity sag.
    IkLead,
}

impl ControllerKind {
    /// All controllers.
    pub const ALL: [Self; 3] = [Self::Osc, Self::Ik, Self::IkLead];

    /// Name of the controller in files, tables and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Osc => "osc",
            Self::Ik => "ik",
            Self::IkLead => "ik-lead",
        }
    }

    /// Description in one line.
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::Osc => "Operational-space control: joint torques",
            Self::Ik => "Inverse kinematics, streamed as joint positions, without torque control",
            Self::IkLead => {
                "Inverse kinematics with velocity lead and compensation of gravity sag, streamed as joint positions"
            }
        }
    }
}
