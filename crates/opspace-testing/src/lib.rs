//! Tools for opspace's own development; no part of it is released.
//!
//! Shared by the tests and the benches of all crates, and without a dependency on any of them: the count of allocations
//! ([`allocation`]) and the numbers of foreign programs ([`oracle`]). The example `same-bits` compares two builds of
//! opspace.

pub mod allocation;
pub mod oracle;
