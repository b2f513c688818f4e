//! The `opspace` program: the command line without additional drivers or tasks.

use opspace_cli::{Extensions, main_with};
use std::process::ExitCode;

fn main() -> ExitCode {
    main_with(Extensions::default())
}
