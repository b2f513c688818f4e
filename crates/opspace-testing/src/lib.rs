//! Tools for opspace's own development; no part of it is released.
//!
//! Shared by the tests and benches of all crates, without depending on any of them: a counter of allocations
//! ([`allocation`]) and the reference values computed by other programs ([`oracle`]). The example `same-bits`
//! compares two builds of
//! opspace.

pub mod allocation;
pub mod oracle;
