//! The `opspace` command line.

mod cli;
mod commands;
mod console;
mod interrupt;
mod output;

use clap::Parser;
use cli::{Cli, Command};
use console::{Console, Exit};
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let console = Console { verbose: cli.verbose, quiet: cli.quiet };
    let outcome = match &cli.command {
        Command::Run(args) => commands::run::run(args, console),
        Command::Bench(args) => commands::bench::bench(args, console),
        Command::Replay(args) => commands::replay::replay(args, console),
        Command::Report(args) => commands::report::report(args, console),
        Command::Check(args) => commands::check::check(args, console),
        Command::Identify(args) => commands::identify::identify(args, console),
        Command::Model(args) => commands::model::model(args, console),
        Command::New(args) => commands::new::new(args, console),
        Command::Schema(args) => commands::schema::schema(args.kind),
        Command::Completion { shell } => commands::completion::completion(*shell),
    };
    let exit: Exit = outcome.unwrap_or_else(|failure| console::report(&failure));
    exit.into()
}
