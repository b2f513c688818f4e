//! Strict priorities: tasks at their levels, and the freedom that each leaves.

pub(crate) mod level;
pub(crate) mod nullspace;
pub(crate) mod products;
pub mod rank;
pub mod stacks;
pub mod task;
