//! Robots behind ROS 2 topics, without a ROS installation.
//!
//! [`Ros2Driver`] is the driver `ros2` of `[driver]` in robot.toml; the README lists its keys, faults, topics and services.
//! [`RosArm`] is the robot as a [`Backend`](opspace_backend::Backend). [`states`], [`wrenches`], [`commands`], [`inputs`],
//! [`frames`] and [`clutch`] say what messages mean, without input and output; [`node`] has the client of DDS, and [`link`] the
//! threads and rings between it and the control loop. [`companion`] enters targets into a run, and [`outputs`] publishes its rows.
//!
//! No real arm has been run with this crate.
//!
//! ```no_run
//! use opspace_cli::{Extensions, main_with};
//! use opspace_ros2::{Program, extend};
//!
//! let program = Program::default();
//! let exit = main_with(extend(Extensions::default(), &program));
//! ```

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
pub mod program;
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
pub use program::Program;

use opspace_experiment::Extensions;

/// Adds the driver, and the targets, outputs and services of its runs.
#[must_use]
pub fn extend(extensions: Extensions, program: &Program) -> Extensions {
    let companion = companion::entry(program.participants.clone(), program.tare.clone());
    extensions.with_driver(Ros2Driver::new(program.clone())).with(companion)
}
