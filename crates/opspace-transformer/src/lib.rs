//! Conversion of joint torques to the commands that make a robot's servos produce them.
//!
//! A [`Transformer`] computes the command. A [`ServoLaw`] is the servo that the transformer inverts; it is evaluated at
//! every servo tick.
//!
//! ```
//! use opspace_backend::quantity::Positive;
//! use opspace_model::{Data, Model, kinematics};
//! use opspace_transformer::{CascadedServo, PaperTransformer, ServoLaw, ServoParameters, Transformer};
//!
//! // A joint with a position servo: τ = kv [kp (q_d − q) − q̇], at 5 kHz.
//! let urdf = r#"<robot name="pendulum">
//!   <link name="base"/>
//!   <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
//!   <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
//!     <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
//! </robot>"#;
//! let model = Model::from_urdf(urdf)?.model;
//! let (kp_per_s, kv_nms_per_rad) = (Positive::literal(20.0), Positive::literal(30.0));
//! let velocity_filter_hz = Positive::literal(600.0);
//! let servo =
//!     ServoParameters::Cascaded(CascadedServo::new(kp_per_s, kv_nms_per_rad, velocity_filter_hz));
//! let period_s = 2e-4;
//! let law = ServoLaw::new(&servo, period_s)?;
//! let mut transformer = PaperTransformer::new(vec![servo.gains(period_s)]);
//!
//! // Someone turns the joint at 0.4 rad/s; 3 Nm are desired meanwhile.
//! let (mut data, mut q_d, mut torque) = (Data::new(&model), [0.0], 0.0);
//! let (mut memory, _) = law.rest(0.0, 0.0);
//! for tick in 0..100 {
//!     let q = 0.4 * f64::from(tick) * period_s;
//!     kinematics(&model, &mut data, &[q], &[0.4]);
//!     transformer.transform(&data, &[3.0], &mut q_d);
//!     torque = law.step(&mut memory, q_d[0], q);
//! }
//! assert!((torque - 3.0).abs() < 1e-9, "the servo produces it");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod active_setpoints;
pub mod cascaded_servo;
pub mod closed_loop_model;
pub mod current;
pub mod drive_timing;
pub mod estimator;
pub mod extrapolating_transformer;
pub mod friction;
pub mod friction_observer;
pub mod gain_adaptation;
pub mod identity;
pub mod impedance;
pub mod impulse_response;
pub mod momentum_observer;
mod motion_estimator;
pub mod moving_joint;
pub mod observed;
pub mod observer;
#[cfg(feature = "schema")]
mod optional_keys;
pub mod parameters;
pub mod pid_servo;
pub mod polynomial;
mod reference;
pub mod remaining_damping;
pub mod servo;
pub mod servo_gains;
pub mod servo_inversion;
pub mod servo_law;
pub mod servo_model_transformer;
pub mod servo_structure;
pub mod setpoint_average;
pub mod setpoint_filter;
pub mod setpoint_governor;
pub mod setpoint_limits;
pub mod torque_observer;
pub mod transfer_function_servo;
pub mod transformer;
pub mod velocity_servo;
pub mod velocity_transformer;

pub use cascaded_servo::CascadedServo;
pub use closed_loop_model::{ClosedLoopModel, IdentificationError, TransferFunction};
pub use current::{CurrentFeedback, CurrentObserver};
pub use drive_timing::DriveTiming;
pub use estimator::{EstimatorParameters, VelocityEstimator, VelocitySource};
pub use extrapolating_transformer::{ExtrapolatingTransformer, ExtrapolationSetup, SetpointNoise};
pub use friction::{FrictionCompensation, FrictionCompensationParameters, FrictionLaw, FrictionParameters};
pub use friction_observer::FrictionObserver;
pub use gain_adaptation::{GainAdaptation, GainAdaptationParameters};
pub use identity::Identity;
pub use momentum_observer::MomentumObserver;
pub use observed::ObservedTransformer;
pub use observer::{ObservedJoint, ObserverGain};
pub use parameters::{JointParameters, ProfileParameters, RotorParameters};
pub use pid_servo::{DerivativeOf, PidServo};
pub use remaining_damping::RemainingDamping;
pub use servo::ServoParameters;
pub use servo_gains::ServoGains;
pub use servo_inversion::{EmulationError, TorqueObjective};
pub use servo_law::{ServoError, ServoLaw, ServoState, SetpointParameters};
pub use servo_model_transformer::{EmulatingTransformer, EmulationSetup};
pub use servo_structure::{IdentifiedGains, IdentifiedKeys, ServoStructure};
pub use setpoint_average::SetpointAverage;
pub use setpoint_filter::SetpointFilter;
pub use setpoint_limits::{
    JointSetpointLimits, SetpointLimit, SetpointLimitParameters, SetpointReaction, SetpointStream,
};
pub use torque_observer::{TorqueObserver, TorqueObserverSetup};
pub use transfer_function_servo::TransferFunctionServo;
pub use transformer::{DeclaredProperties, Gears, PaperTransformer, Transformer, TransformerName};
pub use velocity_servo::VelocityServo;
pub use velocity_transformer::VelocityTransformer;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
