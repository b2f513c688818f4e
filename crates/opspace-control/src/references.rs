//! Reference motions of tasks: position, velocity and acceleration.

pub(crate) mod blend;
pub mod goal;
pub mod joint_reference;
pub mod online;
pub mod ramp;
pub mod recorded;
pub mod reference;
pub mod scalar_reference;
pub mod streamed;
pub mod streamed_joints;
pub mod streamed_pose;
pub mod target;
pub mod wave;
