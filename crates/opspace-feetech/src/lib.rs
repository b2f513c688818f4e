//! Arms on Feetech's servo bus.

#![forbid(unsafe_code)]

pub mod arm;
pub mod arm_config;
pub mod bus;
pub mod calibration;
pub mod counts;
pub mod driver;
pub mod fault;
pub mod protocol;
#[cfg(target_os = "linux")]
pub mod serial_port;
pub mod simulated;
mod start;
pub mod transport;

pub use arm::FeetechArm;
pub use arm_config::ArmConfig;
pub use driver::FeetechDriver;
pub use fault::BusFault;
