//! Operational-space control for robots that take torques, and for robots that take only positions.
//!
//! The one crate to depend on: it re-exports the others. The command line is the crate `opspace-cli`.
//!
//! | to | use |
//! |---|---|
//! | read a URDF, compute kinematics and dynamics | [`model`] |
//! | turn tasks into torques in a loop of your own | [`control`] |
//! | turn torques into the commands of a position robot | [`transformer`] |
//! | write a driver for a robot | [`backend`] |
//! | run a controller on a robot, with supervision | [`control_loop`] |
//! | simulate an arm with its servos and sensors | [`sim`] |
//! | record, read and replay runs | [`log`] |
//! | identify the servos of a robot | [`identify`] |
//! | run robot and task files | [`experiment`] |

#![forbid(unsafe_code)]

pub use opspace_backend as backend;
pub use opspace_control as control;
pub use opspace_experiment as experiment;
pub use opspace_identify as identify;
pub use opspace_log as log;
pub use opspace_loop as control_loop;
pub use opspace_model as model;
pub use opspace_sim as sim;
pub use opspace_transformer as transformer;
