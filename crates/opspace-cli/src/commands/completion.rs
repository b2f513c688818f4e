//! `opspace completion`: completion script of a shell.

use crate::cli::command;
use crate::console::{Exit, Outcome, print_exactly};
use clap_complete::{Shell, generate};
use opspace_experiment::Extensions;

pub fn completion(shell: Shell, extensions: &Extensions) -> Outcome {
    let mut script = Vec::new();
    generate(shell, &mut command(extensions), "opspace", &mut script);
    print_exactly(&String::from_utf8_lossy(&script))?;
    Ok(Exit::Done)
}
