//! Table of the commands.

use crate::cli::{
    BenchArgs, CheckArgs, Cli, CompletionArgs, ExplainArgs, IdentifyArgs, LogArgs, MergeArgs, ModelArgs,
    NewArgs, ReplayArgs, ReportArgs, RunArgs, SchemaArgs,
};
use crate::commands::{
    bench, check, completion, explain, identify, log, merge, model, new, replay, report, run, schema,
};
use crate::console::{self, Console, Exit, Outcome};
use clap::{ArgMatches, CommandFactory, FromArgMatches};
use opspace_experiment::{Entry, Extensions};
use std::fmt;
use std::process::ExitCode;
use std::sync::Arc;

/// Command of the program: `opspace NAME`.
#[derive(Clone)]
pub struct Command {
    name: &'static str,
    action: Action,
}

type Added = dyn Fn(&ArgMatches, &Extensions) -> ExitCode + Send + Sync;

#[derive(Clone)]
enum Action {
    BuiltIn { arguments: fn() -> clap::Command, run: fn(&ArgMatches, &Extensions, Console) -> Outcome },
    Added { arguments: Arc<clap::Command>, run: Arc<Added> },
}

impl Command {
    /// Creates a command with these arguments and this help, for example `clap::Command::new("hello").about("Greet.")`.
    #[must_use]
    pub fn new(
        name: &'static str,
        arguments: clap::Command,
        run: impl Fn(&ArgMatches, &Extensions) -> ExitCode + Send + Sync + 'static,
    ) -> Self {
        Self { name, action: Action::Added { arguments: Arc::new(arguments.name(name)), run: Arc::new(run) } }
    }

    const fn built_in<A: CommandFactory>(
        name: &'static str,
        run: fn(&ArgMatches, &Extensions, Console) -> Outcome,
    ) -> Self {
        Self { name, action: Action::BuiltIn { arguments: A::command, run } }
    }

    fn arguments(&self) -> clap::Command {
        match &self.action {
            Action::BuiltIn { arguments, .. } => arguments(),
            Action::Added { arguments, .. } => clap::Command::clone(arguments),
        }
    }

    /// Executes the command and reports its failure.
    pub(crate) fn run(&self, matches: &ArgMatches, extensions: &Extensions, console: Console) -> ExitCode {
        match &self.action {
            Action::BuiltIn { run, .. } => {
                let exit: Exit =
                    run(matches, extensions, console).unwrap_or_else(|failure| console::report(&failure));
                exit.into()
            }
            Action::Added { run, .. } => run(matches, extensions),
        }
    }
}

impl Entry for Command {
    const KIND: &'static str = "command";

    fn built_in() -> &'static [Self] {
        &BUILT_IN
    }

    fn name(&self) -> &str {
        self.name
    }
}

impl fmt::Debug for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// The built-in commands, in the order of the help.
static BUILT_IN: [Command; 13] = [
    Command::built_in::<RunArgs>("run", |m, extensions, console| run::run(&args(m)?, extensions, console)),
    Command::built_in::<BenchArgs>("bench", |m, extensions, console| {
        bench::bench(&args(m)?, extensions, console)
    }),
    Command::built_in::<MergeArgs>("merge", |m, extensions, console| {
        merge::merge(&args(m)?, extensions, console)
    }),
    Command::built_in::<ReplayArgs>("replay", |m, extensions, console| {
        replay::replay(&args(m)?, extensions, console)
    }),
    Command::built_in::<ReportArgs>("report", |m, extensions, console| {
        report::report(&args(m)?, extensions, console)
    }),
    Command::built_in::<LogArgs>("log", |m, _, console| log::log(&args::<LogArgs>(m)?.command, console)),
    Command::built_in::<CheckArgs>("check", |m, extensions, console| {
        check::check(&args(m)?, extensions, console)
    }),
    Command::built_in::<ExplainArgs>("explain", |m, _, _| explain::explain(args::<ExplainArgs>(m)?.code)),
    Command::built_in::<IdentifyArgs>("identify", |m, _, console| identify::identify(&args(m)?, console)),
    Command::built_in::<ModelArgs>("model", |m, _, console| model::model(&args(m)?, console)),
    Command::built_in::<NewArgs>("new", |m, extensions, console| new::new(&args(m)?, extensions, console)),
    Command::built_in::<SchemaArgs>("schema", |m, extensions, _| schema::schema(&args(m)?, extensions)),
    Command::built_in::<CompletionArgs>("completion", |m, extensions, _| {
        completion::completion(args::<CompletionArgs>(m)?.shell, &mut program(extensions))
    }),
];

/// Arguments of a command. Clap has already checked them.
fn args<A: FromArgMatches>(matches: &ArgMatches) -> Result<A, console::Failure> {
    A::from_arg_matches(matches).map_err(|error| console::Failure::Other(error.to_string(), Exit::Bad))
}

/// Arguments of the whole program.
pub(crate) fn program(extensions: &Extensions) -> clap::Command {
    Cli::command().subcommands(extensions.all::<Command>().map(Command::arguments))
}
