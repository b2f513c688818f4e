//! `opspace completion`: completion script of a shell.

use crate::cli::Cli;
use crate::console::{Exit, Outcome, print_exactly};
use clap::CommandFactory;
use clap_complete::{Shell, generate};

pub fn completion(shell: Shell) -> Outcome {
    let mut script = Vec::new();
    generate(shell, &mut Cli::command(), "opspace", &mut script);
    print_exactly(&String::from_utf8_lossy(&script))?;
    Ok(Exit::Done)
}
