//! Robots behind ROS 2 topics, without a ROS installation.

#![forbid(unsafe_code)]

pub mod arm;
pub mod clutch;
pub mod commands;
pub mod companion;
pub mod config;
pub mod description;
pub mod driver;
pub mod fault;
pub mod following;
pub mod frames;
pub mod inputs;
pub mod interface;
pub mod link;
pub mod messages;
pub mod node;
pub mod outputs;
pub mod pace;
pub mod reports;
pub mod start;
pub mod states;
pub mod tare;
pub mod wake;
pub mod wrenches;

pub use arm::RosArm;
pub use config::RosConfig;
pub use driver::Ros2Driver;
pub use fault::RosFault;

use node::Participants;
use opspace_experiment::Extensions;
use reports::Reports;
use tare::Tare;

/// What the driver and the nodes of tasks share.
#[derive(Clone, Default)]
pub struct Program {
    /// Participants of the nodes.
    pub participants: Participants,
    /// Sentences about the runs.
    pub reports: Reports,
    /// Tare of the force sensors.
    pub tare: Tare,
}

impl Program {
    /// Adds the driver, the targets, outputs and services of its runs, and the commands of this program.
    #[must_use]
    pub fn extend(&self, extensions: Extensions) -> Extensions {
        extensions
            .with_driver(Ros2Driver::new(self.clone()))
            .with(companion::entry(self.participants.clone(), self.tare.clone()))
    }
}
