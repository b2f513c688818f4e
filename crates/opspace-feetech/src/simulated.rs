//! A simulated bus: servos with their registers, on joints of a model of the caller's.

pub mod bus;
pub mod joints;
#[cfg(target_os = "linux")]
pub mod pseudo_terminal;
pub mod servo;
pub mod transport;

pub use bus::{BusOptions, SimulatedBus};
pub use joints::{JointModel, SeparateJoint, SeparateJoints};
#[cfg(target_os = "linux")]
pub use pseudo_terminal::PseudoTerminal;
pub use servo::{ServoOptions, SimulatedServo};
pub use transport::SimulatedTransport;
