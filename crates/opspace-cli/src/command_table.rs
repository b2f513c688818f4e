//! Table of the commands.

use crate::cli::{
    BenchArgs, CheckArgs, Cli, CompletionArgs, DoctorArgs, DriverArgs, ExplainArgs, IdentifyArgs, LogArgs,
    MergeArgs, ModelArgs, NewArgs, ReplayArgs, ReportArgs, RunArgs, SchemaArgs, ViewLogArgs, with_names,
};
use crate::commands::{
    bench, check, completion, doctor, driver, explain, identify, log, merge, model, new, replay, report, run,
    schema, view,
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
static BUILT_IN: [Command; 16] = [
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
    Command::built_in::<ViewLogArgs>("view", |m, extensions, console| {
        view::view(&args(m)?, extensions, console)
    }),
    Command::built_in::<LogArgs>("log", |m, _, console| log::log(&args::<LogArgs>(m)?.command, console)),
    Command::built_in::<CheckArgs>("check", |m, extensions, console| {
        check::check(&args(m)?, extensions, console)
    }),
    Command::built_in::<ExplainArgs>("explain", |m, _, _| explain::explain(args::<ExplainArgs>(m)?.code)),
    Command::built_in::<IdentifyArgs>("identify", |m, extensions, console| {
        identify::identify(&args(m)?, extensions, console)
    }),
    Command::built_in::<DriverArgs>("driver", |m, extensions, console| {
        driver::driver(&args::<DriverArgs>(m)?.command, extensions, console)
    }),
    Command::built_in::<DoctorArgs>("doctor", |m, _, console| doctor::doctor(&args(m)?, console)),
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
    with_names(Cli::command().subcommands(extensions.all::<Command>().map(Command::arguments)), extensions)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "a test")]

    use super::program;
    use crate::cli::RunArgs;
    use clap::FromArgMatches;
    use opspace_experiment::{Experiment, Extensions, Files, PlantEntry, Progress, RunOptions};
    use opspace_log::Recording;
    use opspace_sim::{PhysicsEngine, Plant, PlantConfig, PlantError, RigidEngine, Scene};
    use std::io::Cursor;
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// The library's own plant under another name, with a count of the plants that it has built.
    #[derive(Clone, Debug, Default)]
    struct Counting(Arc<AtomicUsize>);

    impl PhysicsEngine for Counting {
        fn name(&self) -> &str {
            "counting"
        }

        fn version(&self) -> &str {
            "1"
        }

        fn scene(&self) -> Option<&Scene> {
            None
        }

        fn build(&self, parts: PlantConfig) -> Result<Box<dyn Plant>, PlantError> {
            self.0.fetch_add(1, Ordering::Relaxed);
            RigidEngine.build(parts)
        }
    }

    /// Rows of a run with a plant that the command line names, and the label of the plant.
    fn run(extensions: &Extensions, plant: &str) -> (Vec<u64>, String) {
        let arguments = ["opspace", "run", "task.toml", "--plant", plant];
        let matches = program(extensions).try_get_matches_from(arguments).unwrap();
        let args = RunArgs::from_arg_matches(matches.subcommand_matches("run").unwrap()).unwrap();
        let options = RunOptions { duration_s: Some(0.5), ..RunOptions::default() };
        let task = Path::new("tasks/cartesian-tracking.toml");
        let settings = ["settle_s=0.1".to_owned()];
        let experiment = Experiment::load(Files::Embedded, task, None, options, &settings).unwrap();
        let experiment = match args.plant.open(extensions).unwrap() {
            Some(engine) => experiment.on_engine(engine).unwrap(),
            None => experiment,
        };
        let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
        let log = Recording::from_bytes(result.sink.get_ref()).unwrap();
        let tick = log.tick().unwrap();
        (
            (0..tick.len())
                .flat_map(|row| tick.row(row).iter().map(|value| value.to_bits()).collect::<Vec<_>>())
                .collect(),
            experiment.plant(),
        )
    }

    /// Compared: runs on the own plant, and on the same one that a user has registered.
    #[test]
    fn registered_plant_is_run_by_its_name() {
        let counting = Counting::default();
        let opened = counting.clone();
        let entry = PlantEntry::new("counting", "counts", move |_| Ok(Arc::new(opened.clone())));
        let extensions = Extensions::default().with(entry);
        let ((own, own_label), (registered, label)) = (run(&extensions, "own"), run(&extensions, "counting"));
        assert_eq!((own_label.as_str(), label.as_str()), ("own", "counting 1"));
        assert!(counting.0.load(Ordering::Relaxed) > 0 && own.len() > 1000);
        assert_eq!(own, registered);
        let help = program(&extensions).find_subcommand_mut("run").unwrap().render_help().to_string();
        assert!(help.contains("- counting: counts"), "{help}");
    }
}
