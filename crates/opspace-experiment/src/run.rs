//! Experiments: a task on a robot, run in simulation or replayed from a log.

pub mod execute;
pub mod experiment;
pub mod replay;
mod transformer;
