//! A simulated bus: servos with their registers, on joints of a model of the caller's, or on a simulated arm.

pub mod arm_joints;
pub mod bus;
pub mod devices;
pub mod joints;
#[cfg(target_os = "linux")]
pub mod pseudo_terminal;
pub mod servo;
pub mod transport;

pub use arm_joints::ArmJoints;
pub use bus::{BusOptions, SimulatedBus};
pub use devices::bus_with_arm;
pub use joints::{JointModel, SeparateJoint, SeparateJoints};
#[cfg(target_os = "linux")]
pub use pseudo_terminal::PseudoTerminal;
pub use servo::{ServoOptions, SimulatedServo};
pub use transport::SimulatedTransport;
