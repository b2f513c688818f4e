//! The commands, one file each.

pub mod bench;
pub mod check;
pub mod completion;
pub mod identify;
pub mod model;
pub mod new;
pub mod replay;
pub mod report;
pub mod run;
pub mod schema;
