//! `opspace completion`: completion script of a shell.

use crate::console::{Exit, Outcome, print_exactly};
use clap_complete::{Shell, generate};

pub fn completion(shell: Shell, program: &mut clap::Command) -> Outcome {
    let mut script = Vec::new();
    generate(shell, program, "opspace", &mut script);
    print_exactly(&String::from_utf8_lossy(&script))?;
    Ok(Exit::Done)
}
