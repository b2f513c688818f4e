//! Joint limits, and the commands that keep them.

pub mod bounds;
pub mod joint_limits;
pub(crate) mod limiter;
