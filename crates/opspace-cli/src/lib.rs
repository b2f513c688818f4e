//! The `opspace` command line, and [`main_with`]: the same command line in a user's program, with additional drivers,
//! tasks, transformers and plants.
//!
//! ```no_run
//! use opspace_cli::{Extensions, main_with};
//! use std::process::ExitCode;
//!
//! fn main() -> ExitCode {
//!     main_with(Extensions::default())
//! }
//! ```

#![forbid(unsafe_code)]

mod browser;
mod cli;
mod command_table;
mod commands;
mod console;
#[cfg(feature = "drivers")]
mod drivers;
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
mod view_address;
mod xacro;

pub use clap;
pub use command_table::Command;
use command_table::program;
use console::{Console, Exit, Failure, escaped, report};
pub use opspace_experiment::Extensions;
use std::ffi::OsString;
use std::process::ExitCode;

/// Runs the complete command line with the given extensions. Reads the arguments of the program and returns
/// its exit code.
#[must_use]
pub fn main_with(extensions: Extensions) -> ExitCode {
    main_with_args(extensions, std::env::args_os())
}

/// Runs the complete command line as [`main_with`] does, with these arguments; the first one is the name of the program.
/// Invalid arguments end the process.
#[must_use]
pub fn main_with_args(
    extensions: Extensions,
    args: impl IntoIterator<Item = impl Into<OsString>>,
) -> ExitCode {
    let extensions = extensions.with(plant::mujoco());
    #[cfg(feature = "drivers")]
    let extensions = drivers::with_drivers(extensions);
    let extensions = &extensions;
    let args: Vec<OsString> = args.into_iter().map(Into::into).collect();
    let matches = match program(extensions).try_get_matches_from(&args) {
        Ok(matches) => matches,
        Err(error) => return refuse(extensions, &args, &error),
    };
    let console = Console { verbose: matches.get_flag("verbose"), quiet: matches.get_flag("quiet") };
    // Clap requires a subcommand, one of the table.
    let command = matches.subcommand();
    let command = command.and_then(|(name, args)| Some((extensions.get::<Command>(name)?, args)));
    command.map_or(ExitCode::FAILURE, |(command, args)| command.run(args, extensions, console))
}

/// Prints help, or the error about arguments. They are quoted in it, and are shown without control characters.
fn refuse(extensions: &Extensions, args: &[OsString], error: &clap::Error) -> ExitCode {
    let shown = args.iter().map(|argument| escaped(&argument.to_string_lossy()).into_owned());
    match program(extensions).try_get_matches_from(shown) {
        Err(error) => error.exit(),
        Ok(_) => {
            report(&Failure::Other(error.to_string(), Exit::Bad));
            Exit::Bad.into()
        }
    }
}

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
