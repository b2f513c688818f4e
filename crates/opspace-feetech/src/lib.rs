//! Arms on Feetech's servo bus.

#![forbid(unsafe_code)]

pub mod protocol;
