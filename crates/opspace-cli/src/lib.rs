//! The `opspace` command line, and [`main_with`]: the same command line in a user's program, with additional drivers
//! and tasks.
//!
//! ```no_run
//! use opspace_cli::{Extensions, main_with};
//! use std::process::ExitCode;
//!
//! fn main() -> ExitCode {
//!     main_with(&Extensions::default())
//! }
//! ```

#![forbid(unsafe_code)]

mod browser;
mod cli;
mod commands;
mod console;
mod interrupt;
mod key_page;
mod output;
mod outputs;
mod plant;
mod result_folder;
mod run_progress;
pub mod samples;
mod schema_defaults;
mod shard;
mod suite_results;
mod sweep;

use clap::Parser;
use cli::{Cli, Command};
use console::{Console, Exit};
pub use opspace_experiment::Extensions;
use std::process::ExitCode;

/// Runs the complete command line with the given drivers and tasks. Reads the arguments of the program and returns
/// its exit code.
#[must_use]
pub fn main_with(extensions: &Extensions) -> ExitCode {
    let cli = Cli::parse();
    let console = Console { verbose: cli.verbose, quiet: cli.quiet };
    let outcome = match &cli.command {
        Command::Run(args) => commands::run::run(args, extensions, console),
        Command::Bench(args) => commands::bench::bench(args, extensions, console),
        Command::Merge(args) => commands::merge::merge(args, extensions, console),
        Command::Replay(args) => commands::replay::replay(args, extensions, console),
        Command::Report(args) => commands::report::report(args, extensions, console),
        Command::Log(command) => commands::log::log(command, console),
        Command::Check(args) => commands::check::check(args, extensions, console),
        Command::Explain(args) => commands::explain::explain(args.code),
        Command::Identify(args) => commands::identify::identify(args, console),
        Command::Model(args) => commands::model::model(args, console),
        Command::New(args) => commands::new::new(args, console),
        Command::Schema(args) => commands::schema::schema(args),
        Command::Completion { shell } => commands::completion::completion(*shell),
    };
    let exit: Exit = outcome.unwrap_or_else(|failure| console::report(&failure));
    exit.into()
}

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
