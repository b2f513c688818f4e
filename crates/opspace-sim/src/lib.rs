//! Simulated arms: rigid bodies, drivetrains, multirate servos, sensors and environment.
//!
//! A [`SimulatedArm`] is a [`Backend`](opspace_backend::Backend), alone or as one arm of a [`Simulation`]. All kinds of
//! robot have the same plant behind the same interface:
//!
//! | robot | before the first command, on `Hold` and after `stop` |
//! |---|---|
//! | position | its servos keep the last setpoints |
//! | torque or velocity, with brakes | brakes are engaged and motors are off; the next command releases them when it acts |
//! | torque, without brakes | its position servos hold the position and the torque that they take over |
//! | velocity, without brakes | its servos are commanded zero velocity: without an integral the arm sags under its weight |
//!
//! A released brake leaves the arm to velocity servos whose integrals are zero: it sags until they carry its weight. A
//! position robot's servos hold it whether or not it has brakes. Motors of a robot that compensates gravity by itself give
//! torques without gravity, in the rows and in the samples.

#![forbid(unsafe_code)]

pub mod arm;
pub mod bus;
pub mod config;
mod drives;
pub mod drivetrain;
pub mod environment;
pub mod error;
pub mod external;
pub mod fault;
pub mod force_sensor;
pub mod friction;
pub mod integrator;
mod interface;
pub mod motor;
pub mod parameters;
pub mod plant;
pub mod random;
pub mod rigid;
pub mod simulation;
mod timing;
mod truth;

pub use arm::SimulatedArm;
pub use bus::{Bus, BusParameters, DropoutParameters};
pub use config::{ArmConfig, CouplingConfig, SimulationConfig};
pub use environment::{EnvironmentObject, EnvironmentObjectParameters, SpringParameters, WorldAxis};
pub use error::{Key, SimulationError};
pub use external::{ExternalForce, ExternalForceHandle, Pull};
pub use integrator::RungeKutta;
pub use parameters::SimulatedParameters;
pub use plant::{Plant, PlantArm, PlantConfig, PlantCoupling, PlantFrame};
pub use rigid::RigidPlant;
pub use simulation::Simulation;
