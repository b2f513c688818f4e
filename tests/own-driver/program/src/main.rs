//! The complete command line of opspace with an additional driver.

use lagging_arm::LaggingArmDriver;
use opspace_cli::{Extensions, main_with};
use std::process::ExitCode;

fn main() -> ExitCode {
    main_with(Extensions::default().with_driver(LaggingArmDriver))
}
