//! Suites: their files, their runs, and the rows of results.

pub mod grid;
pub(crate) mod seeds;
pub mod shard;
pub mod suite;
pub mod suite_rows;
