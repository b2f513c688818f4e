//! Simulated arms: rigid bodies, drivetrains, multirate servos, sensors and environment.
//!
//! A [`ServoArm`] and a [`TorqueArm`] are each a [`Backend`](opspace_backend::Backend), alone or as an arm of a
//! [`Simulation`]; a [`SimulatedArm`] is one of them. All kinds of
//! robot have the same plant and the same interface; they differ in their behaviour without a command:
//!
//! | robot | before the first command, on `Hold` and after `stop` |
//! |---|---|
//! | position | its servos keep the last setpoints |
//! | torque or velocity, with brakes | brakes engaged, motors off; the next command releases the brakes when it acts |
//! | torque, without brakes | its position servos hold the position and torque at which they take over |
//! | velocity, without brakes | its servos receive zero velocity; without an integral the arm sags under its weight |
//!
//! When the brakes of a velocity robot are released, the integrals of its servos are zero: the arm sags until they hold
//! its weight. The servos of a position robot hold its weight with or without brakes.
//!
//! The drives of a robot that compensates gravity by itself add torques that its model needs at the measured positions,
//! in each servo period, also while brakes hold it. Torques in rows and samples exclude them, and torque limits do not count
//! them. Loads that this model does not have ([`payload`](SimulatedParameters::payload)), and the difference of true and nominal inertia, keep their weight.
//!
//! ```
//! use opspace_backend::quantity::Positive;
//! use opspace_backend::{Backend, Capabilities, Command, CommandKind, Measured, Sample};
//! use opspace_model::Model;
//! use opspace_sim::{ArmConfig, SimulatedArm};
//! use opspace_transformer::{CascadedServo, ServoParameters};
//!
//! // A rod of 2 kg, its centre of mass 0.5 m from the hinge, moved by a position servo.
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
//! let capabilities = Capabilities::new(["hinge"], CommandKind::Position, 1e-3)
//!     .measuring(&[Measured::MotorCurrent])
//!     .simulated();
//! let mut arm = SimulatedArm::new(ArmConfig::ideal(model, capabilities, vec![servo])?)?;
//! let mut sample = Sample::new(arm.capabilities());
//! for _ in 0..2000 {
//!     arm.read(&mut sample)?;
//!     arm.write(Command::Position(&[0.0]))?;
//! }
//!
//! // By hand: the motor carries m g l, and the servo sags by m g l/(kp kv) to make it.
//! let weight_nm = 2.0 * 9.81 * 0.5;
//! let torque = sample.motor_torque.ok_or("measured")?;
//! assert!((torque[0] + weight_nm).abs() < 2e-3);
//! assert!((sample.q[0] - weight_nm / (20.0 * 30.0)).abs() < 1e-5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod arm;
pub mod bus;
mod command_queue;
pub mod config;
mod drives;
pub mod drivetrain;
pub mod engine;
pub mod environment;
pub mod error;
pub mod external;
pub mod fault;
pub mod force_sensor;
pub mod friction;
pub mod gear;
pub mod held_object;
mod ideal;
mod implicit_step;
pub mod integrator;
mod interface;
pub mod motor;
mod motors;
mod own_gravity;
pub mod parameters;
pub mod plant;
pub mod plant_arms;
mod plant_object;
pub mod random;
pub mod rigid;
mod rotating_body;
mod sensor_load;
mod servo;
pub mod servo_arm;
mod servo_drives;
mod setpoint_check;
mod shared_arm;
pub mod simulation;
mod sines;
mod stiff_joint;
mod stiffness;
mod timing;
pub mod torque_arm;
mod torque_drives;
mod torque_sensor;
mod truth;
mod turns;

pub use arm::SimulatedArm;
pub use bus::{Bus, BusParameters, DropoutParameters};
pub use config::{ArmConfig, CouplingConfig, SimulationConfig};
pub use engine::{PhysicsEngine, Plant};
pub use environment::{
    EnvironmentObject, EnvironmentObjectParameters, OperatorMotion, ProbeMotion, SpringParameters, WorldAxis,
};
pub use error::{Key, SimulationError};
pub use external::{ExternalForce, ExternalForceHandle, Pull};
pub use held_object::{GripParameters, HeldObject, HeldObjectConfig, HeldObjectParameters};
pub use integrator::Midpoint;
pub use parameters::SimulatedParameters;
pub use plant::{
    JointTorque, PlantArm, PlantConfig, PlantCoupling, PlantError, PlantFrame, PlantGrip, PlantObject, Scene,
};
pub use plant_arms::PlantArms;
pub use rigid::{RigidEngine, RigidPlant};
pub use servo_arm::ServoArm;
pub use simulation::Simulation;
pub use torque_arm::TorqueArm;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
