//! Quadratic programs and their solvers.

pub mod active_set;
#[cfg(feature = "clarabel")]
pub mod interior_point;
#[cfg(not(feature = "clarabel"))]
#[path = "qp/no_interior_point.rs"]
pub mod interior_point;
pub(crate) mod interval;
pub(crate) mod level_cost;
pub(crate) mod lexicographic;
pub(crate) mod padded;
pub mod quadratic_program;
