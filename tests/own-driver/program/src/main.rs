//! The whole command line of opspace, with a driver of one's own.

use lagging_arm::LaggingArmDriver;
use opspace_cli::{Extensions, main_with};
use std::process::ExitCode;

fn main() -> ExitCode {
    main_with(&Extensions::default().with_driver(LaggingArmDriver))
}
