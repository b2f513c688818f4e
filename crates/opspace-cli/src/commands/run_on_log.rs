//! A run on the measurements of a log: `opspace run --backend replay`, and `opspace replay` with another task,
//! controller, transformer or setting.

use crate::cli::{OpenArgs, OutputArgs, RunArgs};
use crate::console::{Console, Exit, Failure, Outcome, results as table};
use crate::interrupt;
use crate::output::{pretty, read_log};
use crate::result_folder::prepare;
use crate::run_progress::{exit_code_of_robot, with_bar};
use opspace_experiment::files::overrides::split;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::run::result_files::{LOG, REPORT, SUMMARY};
use opspace_experiment::{
    ControllerKind, Experiment, Extensions, Files, RobotDefinition, RunError, RunOptions, Summary,
    TaskDefinition,
};
use opspace_log::Recording;
use opspace_report::folder::in_locked_folder;
use opspace_transformer::TransformerName;
use std::path::{Path, PathBuf};

/// Changes of a run on a log; all else is as in the log.
#[derive(Default)]
pub struct Changes<'a> {
    pub task: Option<&'a Path>,
    pub robot: Option<&'a Path>,
    pub controller: Option<ControllerKind>,
    pub transformer: Option<TransformerName>,
    pub set: &'a [String],
    pub others: Others,
}

/// Options that only `opspace run` has.
#[derive(Default)]
pub struct Others {
    pub profile: Option<String>,
    pub seed: Option<u64>,
    pub duration_s: Option<f64>,
}

impl Changes<'_> {
    /// Returns true if everything is as in the log.
    pub fn are_none(&self) -> bool {
        let Self { task, robot, controller, transformer, set, .. } = self;
        task.is_none() && robot.is_none() && controller.is_none() && transformer.is_none() && set.is_empty()
    }
}

/// `opspace run TASK --backend replay --log LOG`.
pub fn run_on_log(args: &RunArgs, extensions: &Extensions, console: Console) -> Outcome {
    let Some(log) = &args.log else {
        let text = "--backend replay needs a log: add --log LOG, a run.mcap or the folder of a run";
        return Err(Failure::Other(text.to_owned(), Exit::Bad));
    };
    let (log, recording) = read_log(log)?;
    let changes = Changes {
        task: Some(&args.task),
        robot: args.robot.as_deref(),
        controller: Some(args.controller),
        transformer: args.transformer.clone(),
        set: &args.set,
        others: Others { profile: args.profile.clone(), seed: args.seed, duration_s: args.duration_s },
    };
    let experiment = experiment_on_log(&changes, extensions, &log, &recording)?;
    let (summary, folder) = record_on_log(&experiment, &log, &recording, &args.output, console)?;
    args.output.json.print(
        || pretty(&summary),
        || table(console, std::slice::from_ref(&summary), &default_columns(extensions.added())),
    )?;
    say_files(&summary, &folder, &args.open, console);
    Ok(exit_code_of_robot(&summary))
}

/// Experiment of a log with changes, on the log in place of a robot.
pub fn experiment_on_log(
    changes: &Changes<'_>,
    extensions: &Extensions,
    log: &Path,
    recording: &Recording,
) -> Result<Experiment, Failure> {
    let bad = |error: RunError| match error {
        RunError::File(error) => error.into(),
        other => Failure::Other(format!("{}: {other}", log.display()), Exit::Bad),
    };
    let (robot_settings, task_settings) = split(changes.set, "robot");
    let of_files = changes.task.is_some() || changes.robot.is_some();
    // Settings of the task belong to the other task, if there is one.
    let to_log = if of_files { &robot_settings } else { changes.set };
    let logged = Experiment::of_log_changed(extensions, recording, to_log).map_err(bad)?;
    let only_settings = !of_files && changes.controller.is_none() && changes.transformer.is_none();
    if only_settings {
        return Ok(logged.on_log(log.display().to_string(), recording));
    }
    let robot = match changes.robot {
        Some(robot) => RobotDefinition::load(Files::Disk, robot, &robot_settings)?,
        None => logged.robot().clone(),
    };
    let task = match changes.task {
        Some(task) => TaskDefinition::load_with(extensions, Files::Disk, task, &task_settings)?,
        None => logged.task().clone(),
    };
    let options = logged.options().clone();
    let Others { profile, seed, duration_s } = &changes.others;
    let controller = changes.controller.unwrap_or(options.controller);
    let options = RunOptions {
        controller,
        // The transformer of the log does not suit another controller, nor a choice of its own.
        transformer: changes
            .transformer
            .clone()
            .or(options.transformer.filter(|_| controller == options.controller)),
        profile: profile.clone().or(options.profile),
        seed: seed.or(options.seed),
        duration_s: duration_s.or(options.duration_s),
        ..options
    };
    let experiment = Experiment::new(robot, task, options, changes.set.to_vec())?;
    Ok(experiment.on_log(log.display().to_string(), recording))
}

/// Runs an experiment on a log, and writes log, page and summary to a folder.
pub fn record_on_log(
    experiment: &Experiment,
    log: &Path,
    recording: &Recording,
    output: &OutputArgs,
    console: Console,
) -> Result<(Summary, PathBuf), Failure> {
    if let Some(damage) = &recording.damage {
        console.note(&format!("{}: damaged: {damage}", log.display()));
    }
    let (task, robot) = (experiment.task().name(), experiment.robot().name());
    let default = PathBuf::from(format!("runs/{task}-{robot}-replay"));
    let files = [LOG, REPORT, SUMMARY].map(str::to_owned);
    let inputs: Vec<PathBuf> = experiment.input_paths().into_iter().chain([log.to_owned()]).collect();
    let results = prepare(output, &default, &files, &inputs, console)?;
    let progress = interrupt::watch();
    let summary = with_bar((&task, experiment.ticks()), &progress, console, || {
        in_locked_folder(experiment, &results, |sink| experiment.run_on_log(recording, sink, &progress))
    })?;
    Ok((summary, results.path().to_owned()))
}

/// Says why the run was stopped and which files were written, and opens the page if that is wanted.
pub fn say_files(summary: &Summary, folder: &Path, open: &OpenArgs, console: Console) {
    say_fault(summary, console);
    say_written(summary, folder, console);
    open.show(&folder.join(REPORT), console);
}

/// Says which fault stopped a run, and which files are not complete.
pub fn say_fault(summary: &Summary, console: Console) {
    if let Some(fault) = &summary.faulted {
        let time = summary.fault_time_s.unwrap_or(f64::NAN);
        console.note(&format!("stopped at {time:.3} s: {fault}"));
    }
    for file in &summary.not_saved {
        console.note(&format!("not saved completely: {file}"));
    }
}

/// Says which files were written, if all are complete.
pub fn say_written(summary: &Summary, folder: &Path, console: Console) {
    if summary.not_saved.is_empty() {
        console.note(&format!("wrote {}, {REPORT} and {SUMMARY}", folder.join(LOG).display()));
    }
}
