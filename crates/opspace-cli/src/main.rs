//! The `opspace` program: the command line without drivers or tasks of a user's own.

use opspace_cli::{Extensions, main_with};
use std::process::ExitCode;

fn main() -> ExitCode {
    main_with(&Extensions::default())
}
