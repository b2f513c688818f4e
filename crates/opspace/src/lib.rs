//! Operational-space control for robots that take torques, and for robots that take only positions.
//!
//! This crate is the `opspace` command line and the one crate to depend on: it re-exports the others.
//!
//! | to | take |
//! |---|---|
//! | read a URDF, compute kinematics and dynamics | [`model`] |
//! | turn tasks into torques in a loop of your own | [`control`] |
//! | make a position robot take torques | [`backend`] |
//! | simulate an arm with its servos and sensors | [`sim`] |
//! | record, read and replay runs | [`log`] |
//! | run robot and task files | [`experiment`] |

pub use opspace_backend as backend;
pub use opspace_control as control;
pub use opspace_experiment as experiment;
pub use opspace_log as log;
pub use opspace_model as model;
pub use opspace_sim as sim;
