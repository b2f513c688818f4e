//! Robots behind one trait: torque or position, and the transformer between them.
//!
//! A [`Robot`] adapter is a [`PositionRobot`] or a [`TorqueRobot`]; a [`Backend`] makes either one take
//! torques; the [`ControlLoop`] runs a controller on a backend and never knows which it is.

pub mod backend;
pub mod control_loop;
pub mod fault;
pub mod identification;
pub mod interface;
pub mod position;
pub mod robot;
pub mod safety;
pub mod sensing;
pub mod supervisor;
pub mod torque;
pub mod watchdog;

pub use backend::{Backend, Command};
pub use control_loop::{ControlLoop, Ending, Phase};
pub use fault::Fault;
pub use interface::{Facts, ForceSensor, InterfaceParameters};
pub use position::PositionBackend;
pub use robot::{PositionRobot, Robot, TorqueRobot, Trace, Traces};
pub use safety::SafetyParameters;
pub use sensing::Sensing;
pub use supervisor::Continuity;
pub use torque::TorqueBackend;
pub use watchdog::{Watchdog, WatchdogParameters};
