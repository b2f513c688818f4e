//! The control loop, and the shells around it.
//!
//! [`ControlLoop::step`] turns a sample into a command. A [`Run`] adds duration, stop requests, rows and an outcome;
//! [`drive()`] pulls the samples from a [`Backend`](opspace_backend::Backend). A robot with a callback of its own calls
//! [`Run::cycle`].

#![forbid(unsafe_code)]

pub mod control_loop;
pub mod drive;
pub mod fault;
mod guard;
pub mod link;
pub mod loop_config;
pub mod phase;
pub mod run;
pub mod safety;
mod state_estimator;
pub mod supervisor;
pub mod target_stream;
pub mod timeline;
pub mod watchdog;

pub use control_loop::{ControlLoop, Step};
pub use drive::{Driven, drive, drive_together};
pub use fault::Fault;
pub use link::{ChannelParameters, Link, LinkError};
pub use loop_config::{LoopConfig, LoopError};
pub use phase::Phase;
pub use run::{Run, RunOutcome};
pub use safety::SafetyParameters;
pub use target_stream::{TargetReceiver, TargetSender, target_stream};
pub use timeline::{Cycle, Timeline, TimelineError};
pub use watchdog::{Watchdog, WatchdogParameters};
