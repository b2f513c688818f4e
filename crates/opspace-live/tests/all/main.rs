//! Tests of live views, with clients that connect to them.
#![expect(clippy::unwrap_used, reason = "tests")]

mod access;
mod client;
mod decoder;
mod hostile;
mod logs;
mod pushed;
