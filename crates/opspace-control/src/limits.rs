//! Joint limits and their enforcement.

pub mod bounds;
pub mod horizon;
pub mod joint_limits;
pub(crate) mod limiter;
pub(crate) mod resistance;
