//! The contract between opspace and a robot.
//!
//! This crate has no dependencies, so that a driver needs nothing else of opspace. The feature `schema` adds
//! serde and schemars to the quantities and enums that stand in files.

#![forbid(unsafe_code)]

pub mod capabilities;
pub mod command;
pub mod quantity;
pub mod sample;
pub mod signal;
pub mod sink;

pub use capabilities::{GravityBy, Measured, MissedCycle, Setpoints};
pub use command::CommandKind;
pub use sample::Sample;
pub use signal::{Layout, Observable, Row, Signal};
pub use sink::{SERVO, Sink, TICK, TRUTH};
