//! The opspace command line, and one crate that re-exports the rest.
