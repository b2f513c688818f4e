//! References: where a task should be, how fast, and with which acceleration.

pub mod filter;
pub mod goal;
pub mod joint_reference;
pub mod online;
pub mod ramp;
pub mod recorded;
pub mod reference;
pub mod target;
pub mod wave;
