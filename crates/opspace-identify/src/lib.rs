//! Identification of a position servo by moving its joint: kp, kv, velocity filter, delay, inertia and friction.
//!
//! A joint is excited about its current position by odd random-phase [multisines](excitation) at two amplitudes that
//! are small enough for its limits and its motor; the other joints are held. The [frequency responses](response) are
//! computed from setpoints, positions and, if it is measured, motor torque. The [gains] of the servo are fitted to them
//! with an exact model of the servo and joint [between two interface cycles](interval); a
//! [rational](transfer_function) model of T = y/q_d is fitted too. [Friction](friction) is identified from runs
//! at constant velocity in both directions. The structure of the servo, `τ = kv [kp (q_d − y) − w]`, its rates
//! and the limits are known; gains, filter, delay, inertia and friction are identified.
//!
//! A servo without a velocity loop is identified [statically](static_identification), from the weight of the arm.
//!
//! T does not change if inertia, friction and kv are scaled together. The scale of torque comes from the motor current,
//! or from the inertias of URDF and rotor, or is unknown; see [`TorqueScale`].
//!
//! ```
//! use opspace_backend::quantity::Positive;
//! use opspace_backend::{Capabilities, CommandKind, Measured, Setpoints};
//! use opspace_identify::session::ExcitationSession;
//! use opspace_identify::{ExcitationPlan, KnownParameters, identify};
//! use opspace_model::{JointKind, Model};
//! use opspace_sim::{ArmConfig, SimulatedArm};
//! use opspace_transformer::{CascadedServo, ServoParameters};
//!
//! // In place of a robot: a turntable of 0.6 kg m², whose servo has gains that the identification does not know.
//! let urdf = r#"<robot name="turntable"><link name="base"/>
//!   <joint name="hinge" type="continuous"><parent link="base"/><child link="disc"/><axis xyz="0 0 1"/></joint>
//!   <link name="disc"><inertial><mass value="2"/>
//!     <inertia ixx="0.3" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.6"/></inertial></link></robot>"#;
//! let (kp_per_s, kv_nms_per_rad) = (Positive::literal(20.0), Positive::literal(30.0));
//! let velocity_filter_hz = Positive::literal(600.0);
//! let servo =
//!     ServoParameters::Cascaded(CascadedServo::new(kp_per_s, kv_nms_per_rad, velocity_filter_hz));
//! let capabilities = Capabilities::new(["hinge"], CommandKind::Position, 1e-3)
//!     .measuring(&[Measured::MotorCurrent])
//!     .simulated();
//! let model = Model::from_urdf(urdf)?.model;
//! let mut arm = SimulatedArm::new(ArmConfig::ideal(model, capabilities, vec![servo])?)?;
//!
//! let known = KnownParameters {
//!     joint: 0,
//!     servo_period_s: 2e-4,
//!     servo_ticks_per_cycle: 5,
//!     setpoints: Setpoints::Held,
//!     lower: -1.0,
//!     upper: 1.0,
//!     speed_limit: 5.0,
//!     torque_limit: 50.0,
//!     resolution: 1e-6,
//!     inertia: None,
//!     viscous_friction: 0.0,
//! };
//! let plan = ExcitationPlan { period_s: 1.0, realisations: 1, speeds: 3, ..ExcitationPlan::default() };
//! let interrupted = |_ticks: u64| false;
//! let mut session = ExcitationSession::begin(&mut arm, &[JointKind::Continuous], &interrupted)?;
//! let found = identify(&mut session, &known, &plan)?;
//! let servo = found.servo.ok_or("a servo is identified")?;
//! assert!((servo.kp / 20.0 - 1.0).abs() < 0.01);
//! assert!((servo.kv / 30.0 - 1.0).abs() < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod amplitude_level;
mod background;
pub mod confidence;
pub mod excitation;
pub mod friction;
pub mod gains;
pub mod identification;
pub mod interval;
pub mod joint;
pub mod least_squares;
pub mod load;
pub mod response;
pub mod session;
pub mod static_identification;
mod sweep;
pub mod transfer_function;

pub use confidence::{Interval95, ServoIntervals};
pub use identification::{ExcitationPlan, Identification, KnownParameters, TorqueScale};
pub use joint::identify;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
