//! Tools for the development of opspace; they are not part of a release.
//!
//! Shared by the tests and benches of all crates, without dependencies on them: a counter of allocations
//! ([`allocation`]), reference values computed by other programs ([`oracle`]), and a browser ([`browser`]). The example `same-bits` compares
//! two builds of opspace. The package also compiles tests of the other crates (see its Cargo.toml).

pub mod allocation;
pub mod browser;
pub mod oracle;
pub mod random;
