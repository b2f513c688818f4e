//! Operational-space control: tasks to torques.

#![forbid(unsafe_code)]

pub mod controller;
pub mod measurement;
pub mod quantity;
pub mod signal;

pub use controller::{CommandKind, Controller};
pub use measurement::Measurement;
pub use signal::{Layout, Observable, Row, Signal};
