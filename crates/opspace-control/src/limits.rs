//! Joint limits, distances from obstacles and of links, and their enforcement.

pub mod bounds;
pub(crate) mod clip;
pub(crate) mod collision_bounds;
pub mod collision_limits;
pub(crate) mod drag;
pub mod horizon;
pub(crate) mod joint_bound;
pub mod joint_limits;
pub(crate) mod push;
pub(crate) mod resistance;
pub mod viable_speed;
