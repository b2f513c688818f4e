//! `opspace run` of an experiment with several robots.

use crate::cli::RunArgs;
use crate::console::{Console, Exit, Failure, Outcome, render};
use crate::interrupt;
use crate::output::pretty;
use crate::result_folder::prepare;
use crate::run_progress::{coupled_exit_code, with_bar};
use opspace_experiment::report::coupled_table::coupling_table;
use opspace_experiment::run::result_files::{LOG, REPORT, SUMMARY};
use opspace_experiment::{ControllerKind, CoupledExperiment, Extensions, Files};
use std::path::PathBuf;

pub fn run_coupled(args: &RunArgs, extensions: &Extensions, console: Console) -> Outcome {
    refuse_options_of_one_robot(args)?;
    let mut settings = args.set.clone();
    settings.extend(args.seed.map(|seed| format!("seed={seed}")));
    settings.extend(args.duration_s.map(|duration_s| format!("duration_s={duration_s}")));
    let allow = &args.allow.allow;
    let mut experiment =
        CoupledExperiment::load_allowing(extensions, Files::Disk, &args.task, &settings, allow)?;
    let real: Vec<String> = if args.simulate {
        Vec::new()
    } else {
        experiment.real_robots().into_iter().map(str::to_owned).collect()
    };
    if let (Some(robot), true) = (real.first(), !args.plant.is_own()) {
        let text = format!("robot '{robot}' is real, as its [driver] says: add --simulate to choose a plant");
        return Err(Failure::Other(text, Exit::Bad));
    }
    experiment = experiment.checked_for_real_robots(&real)?;
    let on_drivers = !real.is_empty();
    if let Some(engine) = args.plant.open(extensions)? {
        experiment = experiment.on_engine(&engine)?;
    }
    let name = experiment.name();
    let plant = args.plant.suffix();
    let default = PathBuf::from(format!("runs/{name}{plant}"));
    let of_robots = experiment
        .members
        .iter()
        .flat_map(|member| [LOG, REPORT, SUMMARY].map(|file| format!("{}/{file}", member.name)));
    let files: Vec<String> = [REPORT, SUMMARY].map(str::to_owned).into_iter().chain(of_robots).collect();
    let results = prepare(&args.output, &default, &files, &experiment.input_paths(), console)?;
    let progress = interrupt::watch();
    let robots: Vec<String> = experiment
        .members
        .iter()
        .map(|member| format!("{} ({} robot)", member.name, member.experiment.options().backend.name()))
        .collect();
    console.note(&format!("{name}: {}", robots.join(", ")));
    for refusal in experiment.allowed() {
        console.note(&format!("warning: {refusal}"));
    }
    let summary = with_bar((&name, experiment.ticks()), &progress, console, || {
        if on_drivers {
            experiment.run_on_drivers(extensions, &results, &progress)
        } else {
            experiment.run_in_folder(&results, &progress)
        }
    })?;
    args.output
        .json
        .print(|| pretty(&summary), || render(&coupling_table(std::slice::from_ref(&summary))))?;
    for hold in &summary.holds {
        console.note(&format!("{} was held from {:.3} s: {}", hold.robot, hold.from_s, hold.reason));
    }
    for failure in summary.failures() {
        console.note(&failure);
    }
    if summary.not_saved.is_empty() {
        console
            .note(&format!("wrote {}, and a folder for each robot", results.path().join(REPORT).display()));
    }
    args.open.show(&results.path().join(REPORT), console);
    Ok(coupled_exit_code(&summary))
}

/// Refuses options that choose something for one robot: the file states it for each.
fn refuse_options_of_one_robot(args: &RunArgs) -> Result<(), Failure> {
    let given = [
        ("--robot", args.robot.is_some(), "robot"),
        ("--backend", args.backend.is_some(), "backend"),
        ("--controller", args.controller != ControllerKind::Osc, "controller"),
        ("--transformer", args.transformer.is_some(), "transformer"),
        ("--profile", args.profile.is_some(), "profile"),
    ];
    if args.move_to_start {
        let text =
            "--move-to-start is for a task of one robot: move each robot by its own task first".to_owned();
        return Err(Failure::Other(text, Exit::Bad));
    }
    match given.into_iter().find(|(_, is_given, _)| *is_given) {
        None => Ok(()),
        Some((option, _, key)) => Err(Failure::Other(
            format!(
                "{option} is for a task of one robot; this file states it for each: --set robots.NAME.{key}=..."
            ),
            Exit::Bad,
        )),
    }
}
