//! `opspace view`: a log in a browser.

use crate::cli::ViewLogArgs;
use crate::commands::run_in_view::open_view;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::interrupt;
use crate::output::{folder_name, logs_of_run, open_log};
use opspace_experiment::{ControllerKind, Experiment, Extensions, RunError};
use opspace_live::{Pictures, ViewKind, viewed};
use opspace_log::{LogFile, OutcomeRecord};

pub fn view(args: &ViewLogArgs, extensions: &Extensions, console: Console) -> Outcome {
    let paths = logs_of_run(&args.log);
    let (mut robots, mut duration_s) = (Vec::new(), 0.0_f64);
    for path in &paths {
        let (path, log) = open_log(path)?;
        if let Some(damage) = &log.recording().damage {
            console.note(&format!("{}: damaged: {damage}", path.display()));
        }
        let bad = |error: RunError| Failure::Other(format!("{}: {error}", path.display()), Exit::Bad);
        let experiment = Experiment::of_log_with(extensions, log.recording()).map_err(bad)?;
        duration_s = duration_s.max(experiment.duration_s());
        let robot = experiment.membership().map(|membership| membership.robot.clone());
        let name = robot.unwrap_or_else(|| folder_name(&path));
        let prefix = if paths.len() > 1 { format!("/{name}") } else { String::new() };
        let is_ik = experiment.options().controller != ControllerKind::Osc;
        robots.push((is_ik, viewed(&experiment, prefix, &name, false), log));
    }
    // Robots side by side are ghosts of the first one: inverse kinematics is what the others are compared with.
    robots.sort_by_key(|(is_ik, ..)| *is_ik);
    let (shown, logs): (Vec<_>, Vec<LogFile>) =
        robots.into_iter().map(|(_, shown, log)| (shown, log)).unzip();
    let outcomes: Vec<OutcomeRecord> = logs.iter().map(|log| OutcomeRecord::of(log.recording())).collect();
    let fault = outcomes.iter().find_map(|outcome| outcome.fault.clone());
    let interrupted = outcomes.iter().any(|outcome| outcome.interrupted);
    let outcome = fault.unwrap_or_else(|| (if interrupted { "interrupted" } else { "completed" }).to_owned());
    let progress = interrupt::watch();
    let live = open_view(
        (args.at.unwrap_or_default(), &args.view_origin),
        &args.log.display().to_string(),
        ViewKind::Log,
        console,
    )?;
    live.show(shown, duration_s, true);
    let bad = |error| Failure::Other(format!("{}: {error}", args.log.display()), Exit::Bad);
    let pictures = Pictures::read(&live, &logs).map_err(bad)?;
    pictures.play(&live, &outcome, &progress.interrupt);
    Ok(Exit::Done)
}
