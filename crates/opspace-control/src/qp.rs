//! Quadratic programs and their solvers.

pub mod active_set;
pub mod interior_point;
pub(crate) mod interval;
pub(crate) mod level_cost;
pub(crate) mod lexicographic;
pub(crate) mod padded;
pub mod quadratic_program;
