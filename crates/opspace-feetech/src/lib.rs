//! Arms on Feetech's servo bus (STS and SMS series), such as SO-100, SO-101 and LeKiwi.
//!
//! [`FeetechDriver`] is the driver `feetech` of `[driver]` in robot.toml; the README lists its keys. [`FeetechArm`] is the arm as a
//! [`Backend`](opspace_backend::Backend), on any [`Transport`](transport::Transport): a serial port, or a simulated bus.
//! [`protocol`] is the codec, without input and output, and [`simulated`] has servos with registers on joints of any model,
//! also behind a pseudo-terminal for other programs. [`fault`] lists the faults.
//!
//! No real arm has been run with this crate.
//!
//! ```
//! use opspace_backend::{Backend, Command, CommandKind, Sample, Setting, Settings};
//! use opspace_feetech::simulated::{
//!     BusOptions, SeparateJoint, SeparateJoints, ServoOptions, SimulatedBus, SimulatedServo, SimulatedTransport,
//! };
//! use opspace_feetech::{ArmConfig, FeetechArm};
//!
//! // One servo that carries 0.5 Nm, and the calibration that LeRobot would write for it.
//! let joint = SeparateJoint { weight_nm: -0.5, ..SeparateJoint::default() };
//! let joints = SeparateJoints::new(vec![joint], &[0.2]);
//! let servo = SimulatedServo::new(3, ServoOptions::default());
//! let bus = SimulatedBus::new(vec![servo], Box::new(joints), BusOptions::default());
//! let file = std::env::temp_dir().join("opspace-feetech-example.json");
//! std::fs::write(
//!     &file,
//!     r#"{"elbow": {"id": 3, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}}"#,
//! )?;
//!
//! // The keys of `[driver]`: gains are written, read back and compared.
//! let settings = Settings::new(CommandKind::Position, vec!["elbow".to_owned()], 0.01)
//!     .with("calibration", Setting::Text(file.display().to_string()))
//!     .with("p", Setting::Number(16.0))
//!     .with("i", Setting::Number(0.0))
//!     .with("d", Setting::Number(32.0));
//! let mut arm = FeetechArm::start(SimulatedTransport::new(bus), ArmConfig::from_settings(&settings)?)?;
//! let mut sample = Sample::new(arm.capabilities());
//! for _ in 0..300 {
//!     arm.read(&mut sample)?;
//!     arm.write(Command::Position(&[0.3]))?;
//! }
//!
//! // By hand: P = 16 is a spring of 8.9 Nm/rad, which 0.5 Nm deflect by 0.05 rad, give or take friction.
//! assert!((sample.q[0] - 0.25).abs() < 0.01);
//! # std::fs::remove_file(file)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod arm;
pub mod arm_config;
pub mod bus;
pub mod calibration;
pub mod counts;
pub mod driver;
pub mod fault;
pub mod protocol;
pub mod scan;
#[cfg(target_os = "linux")]
pub mod serial_port;
pub mod simulated;
mod start;
pub mod transport;

pub use arm::FeetechArm;
pub use arm_config::{ArmConfig, TorqueSource};
pub use driver::FeetechDriver;
pub use fault::BusFault;
