//! The interface between opspace and a robot.
//!
//! A driver implements [`Backend`] and depends on this crate only; the crate has no dependencies by default. For the
//! quantities and enums that occur in files, the feature `serde` derives deserialization and the feature `schema` also
//! derives JSON Schemas (schemars).
//!
//! ```
//! use opspace_backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, Sample};
//!
//! /// One joint that follows its position setpoint at once.
//! struct Joint {
//!     capabilities: Capabilities,
//!     time_s: f64,
//!     q: f64,
//! }
//!
//! impl Backend for Joint {
//!     fn capabilities(&self) -> &Capabilities {
//!         &self.capabilities
//!     }
//!
//!     fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
//!         self.time_s += self.capabilities.period_s;
//!         sample.time_s = self.time_s;
//!         sample.q[0] = self.q;
//!         Ok(())
//!     }
//!
//!     fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
//!         match command {
//!             Command::Position(q) => self.q = q[0],
//!             Command::Hold => {}
//!             _ => return Err(DeviceFault::new(1, "this joint takes positions only")),
//!         }
//!         Ok(())
//!     }
//!
//!     fn stop(&mut self) {}
//! }
//!
//! let capabilities = Capabilities::new(["elbow"], CommandKind::Position, 1e-3);
//! let mut joint = Joint { capabilities, time_s: 0.0, q: 0.3 };
//! let mut sample = Sample::new(joint.capabilities());
//! joint.read(&mut sample)?;
//! joint.write(Command::Position(&[sample.q[0] + 0.1]))?;
//! joint.read(&mut sample)?;
//! assert_eq!((sample.time_s, sample.q[0]), (2e-3, 0.4));
//! # Ok::<(), DeviceFault>(())
//! ```

#![forbid(unsafe_code)]

pub mod backend;
pub mod capabilities;
pub mod command;
pub mod command_delay;
pub mod driver;
pub mod driver_key;
pub mod fault;
pub mod ground_truth;
pub mod low_pass;
pub mod observed;
pub mod quantity;
pub mod sample;
pub mod signal;
pub mod signal_names;
pub mod sink;

pub use backend::{Backend, RemoteStop};
pub use capabilities::{
    Capabilities, DeviceLimits, ForceSensor, GravityCompensation, Measured, MissedCycle, Setpoints,
    StopMethod, World,
};
pub use command::{Command, CommandKind};
pub use command_delay::{CommandDelay, CommandsInForce, MAX_DELAY_CYCLES};
pub use driver::{
    Driver, DriverError, DriverWarning, FoundDevice, ServedDevices, Setting, Settings, SimulatedDevices,
    StatedServo,
};
pub use driver_key::{DriverKey, KeyValue};
pub use fault::DeviceFault;
pub use ground_truth::{GroundTruth, TruthLayouts, TruthRow};
pub use low_pass::LowPass;
pub use observed::{Observed, ObservedTorque};
pub use sample::{Sample, Status};
pub use signal::{Layout, Observable, Signal, SignalName, SignalRecorder, Units};
pub use signal_names::{DEVICE_FAILED, STOP_REQUESTED, TICK_TIME};
pub use sink::{EXTERNAL, SERVO, Sink, TICK, TIMING, TRUTH};

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
