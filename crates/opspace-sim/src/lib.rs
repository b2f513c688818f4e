//! A simulated arm: rigid bodies, actuators, multirate servo, sensors and surroundings.
//!
//! [`SimulatedArm`] is a position robot or a torque robot; both are the same plant behind the same
//! interface.

pub mod arm;
pub mod bus;
pub mod error;
pub mod force_sensor;
pub mod friction;
pub mod integrator;
pub mod motor;
pub mod parameters;
pub mod plant;
pub mod random;
pub mod setup;
pub mod surroundings;

pub use arm::SimulatedArm;
pub use bus::{Bus, BusParameters, DropoutParameters};
pub use error::{Key, SimulationError};
pub use integrator::RungeKutta;
pub use parameters::SimulatedParameters;
pub use setup::Setup;
pub use surroundings::{SpringParameters, Surrounding, SurroundingParameters, WorldAxis};
