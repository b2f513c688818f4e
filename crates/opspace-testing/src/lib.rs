//! Tools for opspace's own development; no part of it is released.
//!
//! Comparison of the numbers that two builds compute: all runs of the suites by each of them ([`suites`], [`side`]), a
//! hash of every signal of every run ([`hashes`]), and the comparison of two lists of hashes ([`compare`](mod@compare))
//! through a table of the signals that were renamed in between ([`signals`]).

#![forbid(unsafe_code)]

pub mod compare;
pub mod hashes;
pub mod locate;
pub mod side;
pub mod signals;
pub mod suites;
