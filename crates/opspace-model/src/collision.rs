//! Distances between the links of a robot, and between links and obstacles.

mod capsule;
mod proximity;
mod segment;

pub use capsule::{Capsule, CapsuleSource, HalfSpace, LinkCapsule, Obstacle};
pub use proximity::Proximity;
