//! Suites: many runs from one file, their rows of results, and the comparison of two sets of results.
//!
//! A suite file lists tasks, robots, controllers and settings; [`Suite`] reads and checks it, and is the list of its runs.
//! [`suite_rows`] stores each run when it is complete, so that a suite that was cut off is continued, and
//! [`shard`] divides it among machines. [`baseline`] compares the results with earlier ones, and [`csv`] writes them for other
//! programs.

#![forbid(unsafe_code)]

pub mod baseline;
pub mod csv;
pub mod grid;
mod seeds;
pub mod shard;
pub mod suite;
pub mod suite_rows;

pub use suite::Suite;

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
