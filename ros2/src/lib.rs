//! Robots behind ROS 2 topics, without a ROS installation.

#![forbid(unsafe_code)]

pub mod arm;
pub mod commands;
pub mod config;
pub mod driver;
pub mod fault;
pub mod following;
pub mod link;
pub mod messages;
pub mod node;
pub mod pace;
pub mod reports;
pub mod start;
pub mod states;
pub mod wake;
pub mod wrenches;

pub use arm::RosArm;
pub use config::RosConfig;
pub use driver::Ros2Driver;
pub use fault::RosFault;
