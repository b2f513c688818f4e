//! `opspace run`: executes one task on one robot.

use crate::cli::{BackendChoice, RunArgs};
use crate::commands::own_backend;
use crate::commands::run_coupled::run_coupled;
use crate::commands::run_on_log::run_on_log;
use crate::console::{Console, Exit, Failure, Outcome, results as table};
use crate::interrupt;
use crate::output::pretty;
use crate::result_folder::{MOVE_TO_START, prepare};
use crate::run_progress::{exit_code, with_bar};
use opspace_experiment::files::origin::Kind;
use opspace_experiment::metrics::metric::default_columns;
use opspace_experiment::preflight::{checked_for_real_robot, start_diagnostics};
use opspace_experiment::run::result_files::{LOG, REPORT, SUMMARY};
use opspace_experiment::{Experiment, Extensions, Files, Summary};
use std::path::PathBuf;

pub fn run(args: &RunArgs, extensions: &Extensions, console: Console) -> Outcome {
    if Files::Disk.kind(&args.task) == Some(Kind::Experiment) {
        return run_coupled(args, extensions, console);
    }
    if args.backend == Some(BackendChoice::Replay) {
        return run_on_log(args, extensions, console);
    }
    if args.log.is_some() {
        let text = "--log is for --backend replay".to_owned();
        return Err(Failure::Other(text, Exit::Bad));
    }
    let robot = args.robot.as_deref();
    let options = args.options(own_backend(&args.task, robot, &args.set, extensions));
    let experiment = Experiment::load_with(extensions, Files::Disk, &args.task, robot, options, &args.set)?;
    let on_driver = experiment.has_driver() && !args.simulate;
    let experiment = match args.plant.open(extensions)? {
        None => experiment,
        Some(_) if on_driver => {
            let text =
                "this robot is real, as its [driver] says: add --simulate to choose a plant".to_owned();
            return Err(Failure::Other(text, Exit::Bad));
        }
        Some(engine) => experiment.on_engine(engine)?,
    };
    for warning in &experiment.robot().warnings {
        let code = warning.kind().code();
        console.detail(&format!("{}: {warning} [{code}]", experiment.robot().urdf.name()));
    }
    let (task, robot) = (experiment.task().name(), experiment.robot().name());
    let plant = args.plant.suffix();
    let default =
        PathBuf::from(format!("runs/{task}-{robot}-{}{plant}", experiment.options().backend.name()));
    if let (Some(name), Some(reason)) = (experiment.transformer_name(), experiment.transformer_reason()) {
        console.detail(&format!("transformer '{name}': {reason}"));
    }
    let experiment = if on_driver { checked_for_real_robot(experiment)? } else { experiment };
    experiment.allowed().iter().for_each(|refusal| console.note(&format!("warning: {refusal}")));
    note_problems(&experiment, extensions, console);
    let files = [LOG, REPORT, SUMMARY].map(str::to_owned);
    let results = prepare(&args.output, &default, &files, &experiment.input_paths(), console)?;
    let folder = results.path();
    let progress = interrupt::watch();
    console.note(&format!("{task} {}", experiment.start_text()?));
    if args.move_to_start {
        let moved = experiment.move_to_start(extensions, &folder.join(MOVE_TO_START), &progress)?;
        if let Some(moved) = moved.filter(|moved| exit_code(moved) != Exit::Done) {
            args.output.json.print(
                || pretty(&moved),
                || table(console, std::slice::from_ref(&moved), &default_columns(extensions.added())),
            )?;
            say_end(&moved, console);
            console.note(&format!(
                "not run: the robot did not reach the start of the task; see {}",
                folder.join(MOVE_TO_START).display()
            ));
            return Ok(exit_code(&moved));
        }
    }
    let summary = with_bar((&experiment.task().name(), experiment.ticks()), &progress, console, || {
        experiment.in_locked_folder(&results, |log| {
            if on_driver {
                experiment.run_on_driver(extensions, log, &progress)
            } else {
                experiment.run(log, &progress)
            }
        })
    })?;
    args.output.json.print(
        || pretty(&summary),
        || table(console, std::slice::from_ref(&summary), &default_columns(extensions.added())),
    )?;
    say_end(&summary, console);
    say_expectations(&summary, experiment.task().file.expect.len(), console);
    if summary.not_saved.is_empty() {
        console.note(&format!("wrote {}, {REPORT} and {SUMMARY}", folder.join(LOG).display()));
    }
    args.open.show(&folder.join(REPORT), console);
    Ok(exit_code(&summary))
}

/// Prints the codes of the problems at the start, unless quiet. Problems of the references would take longer to find.
fn note_problems(experiment: &Experiment, extensions: &Extensions, console: Console) {
    if console.quiet {
        return;
    }
    let mut codes: Vec<String> = Vec::new();
    let found = start_diagnostics(extensions, experiment);
    for diagnostic in &found {
        let code = format!("[{}]", diagnostic.code);
        if !codes.contains(&code) {
            codes.push(code);
        }
    }
    let problems = match found.len() {
        0 => return,
        1 => "1 problem".to_owned(),
        number => format!("{number} problems"),
    };
    console.note(&format!("note: `opspace check` finds {problems} at the start: {}", codes.join(", ")));
}

/// Says that a complete run met its expectations; those that it missed are in the results.
fn say_expectations(summary: &Summary, number: usize, console: Console) {
    let is_complete = summary.faulted.is_none() && !summary.interrupted;
    if number > 0 && is_complete && summary.missed_expectations.is_empty() {
        console.note(&match number {
            1 => "the expectation is met".to_owned(),
            _ => format!("all {number} expectations are met"),
        });
    }
}

/// Prints the reason why a run ended early.
fn say_end(summary: &Summary, console: Console) {
    if let Some(time_s) = summary.interrupted_time_s {
        console.note(&format!("interrupted at {time_s:.3} s; the log is closed"));
    }
    if let Some(fault) = &summary.faulted {
        let time = summary.fault_time_s.unwrap_or(f64::NAN);
        console.note(&format!("stopped at {time:.3} s: {fault}"));
    }
    for file in &summary.not_saved {
        console.note(&format!("not saved completely: {file}"));
    }
}
