//! `opspace replay`: recomputation of every command of a log.

use crate::cli::ReplayArgs;
use crate::commands::run_on_log::{Changes, experiment_on_log, record_on_log, say_files};
use crate::commands::simulate_log::simulate_log;
use crate::console::{Console, Exit, Failure, Outcome, note};
use crate::output::{Format, folder_name, log_path, logs_of_robots, open_log, pretty, read_log, write_named};
use crate::outputs::check_outputs;
use opspace_backend::signal_names::TICK_CHANNEL;
use opspace_experiment::run::replay::{ReplayReport, compare_run_on_log, replay_log};
use opspace_experiment::{Experiment, Extensions, RunError, Summary};
use opspace_log::{Difference, Recording};
use opspace_report::html::Page;
use opspace_report::what_if::torque_difference;
use serde_json::{Map, Value, json};
use std::path::Path;

pub fn replay(args: &ReplayArgs, extensions: &Extensions, console: Console) -> Outcome {
    if args.simulate {
        return simulate_log(args, extensions, console);
    }
    let robots = logs_of_robots(&args.log);
    let changes = Changes {
        task: args.task.as_deref(),
        controller: args.controller,
        transformer: args.transformer.clone(),
        set: &args.set,
        ..Changes::default()
    };
    if robots.is_empty() && !changes.are_none() {
        return what_if(args, &changes, extensions, console);
    }
    let option = option_of_a_run(args);
    if !robots.is_empty() && (!changes.are_none() || option.is_some()) {
        let text = format!(
            "{}: all options but --json are for the log of one robot: give the folder of a robot in it",
            args.log.display()
        );
        return Err(Failure::Other(text, Exit::Bad));
    }
    let logs = if robots.is_empty() { vec![log_path(&args.log)] } else { robots.clone() };
    check_outputs(&logs, &Vec::from_iter(args.output.json.path().map(Path::to_owned)))?;
    if let Some(option) = option {
        let text = format!(
            "{option} is for a run on the log: add --task, --controller, --transformer or --set, or use `opspace report`"
        );
        return Err(Failure::Other(text, Exit::Bad));
    }
    let (mut text, mut replays, mut exit) = (String::new(), Map::new(), Exit::Done);
    for log in &logs {
        let (log, file) = open_log(log)?;
        let recording = file.recording();
        let bad = |error: RunError| Failure::Other(format!("{}: {error}", log.display()), Exit::Bad);
        if let Some(damage) = &recording.damage {
            console.note(&format!("{}: damaged: {damage}", log.display()));
        }
        let experiment = Experiment::of_log_with(extensions, recording).map_err(bad)?;
        let replayed = replay_log(&experiment, &file).map_err(bad)?;
        text += &verdict(&log, &replayed);
        let robot = experiment.membership().map(|membership| membership.robot.clone());
        let robot = robot.unwrap_or_else(|| folder_name(&log));
        replays.insert(robot, as_json(&log, &experiment, recording, &replayed, false));
        exit = match (exit, exit_code(recording, &replayed)) {
            (Exit::Failed, _) | (_, Exit::Failed) => Exit::Failed,
            (Exit::Done, of_robot) => of_robot,
            (before, _) => before,
        };
    }
    let json = if robots.is_empty() {
        replays.into_iter().next().map_or(Value::Null, |(_, replay)| replay)
    } else {
        json!({ "schema": "opspace.replay-robots/1", "folder": args.log, "robots": replays })
    };
    args.output.json.print(|| pretty(&json), || text)?;
    Ok(exit)
}

/// An option that was given although nothing is run.
fn option_of_a_run(args: &ReplayArgs) -> Option<&'static str> {
    let given = [
        ("--report", args.report.is_some()),
        ("--out", args.output.out.is_some()),
        ("--force", args.output.force),
        ("--open", args.open.open),
    ];
    given.into_iter().find_map(|(option, is_given)| is_given.then_some(option))
}

/// Runs the changed experiment on the log, and compares its commands with the logged ones.
fn what_if(args: &ReplayArgs, changes: &Changes<'_>, extensions: &Extensions, console: Console) -> Outcome {
    let inputs: Vec<_> = args.task.iter().cloned().chain([log_path(&args.log)]).collect();
    check_outputs(&inputs, &Vec::from_iter(args.report.clone()))?;
    let (log, recording) = read_log(&args.log)?;
    let experiment = experiment_on_log(changes, extensions, &log, &recording)?;
    let (summary, folder) = record_on_log(&experiment, &log, &recording, &args.output, console)?;
    let (_, run) = read_log(&folder)?;
    let bad = |error: RunError| Failure::Other(format!("{}: {error}", log.display()), Exit::Bad);
    let replayed = compare_run_on_log(&recording, &run).map_err(bad)?;
    if let Some(page) = &args.report {
        write_report(page, &log, &experiment, (&recording, &run), &replayed)?;
    }
    let json = || {
        let mut json = as_json(&log, &experiment, &recording, &replayed, true);
        json["commands_part_after_s"] = json!(summary.replay.and_then(|replay| replay.commands_part_after_s));
        json["folder"] = json!(folder);
        pretty(&json)
    };
    args.output.json.print(json, || what_if_text(&experiment, &recording, &replayed, &summary))?;
    say_files(&summary, &folder, &args.open, console);
    Ok(lost(&recording))
}

/// Exit code of a replay that must equal its log.
fn exit_code(recording: &Recording, replayed: &ReplayReport) -> Exit {
    let differs = replayed.first_difference.is_some()
        || replayed.compared < replayed.logged
        || !replayed.unmatched.is_empty();
    if differs { Exit::Failed } else { lost(recording) }
}

/// Exit code that says whether the log lacks data.
fn lost(recording: &Recording) -> Exit {
    if recording.damage.is_some() || recording.dropped() > 0 { Exit::DataLost } else { Exit::Done }
}

fn write_report(
    page: &Path,
    log: &Path,
    experiment: &Experiment,
    (recording, run): (&Recording, &Recording),
    replayed: &ReplayReport,
) -> Result<(), Failure> {
    let title = format!("{}: replay with '{}'", log.display(), experiment.task().name());
    let lead = "Open loop: torques computed from the logged measurements. The motion is the logged one.";
    let mut report = Page::new(title).lead(lead).paragraph(&end(experiment, replayed));
    if let Some(figure) = torque_difference(recording, run)? {
        report = report.figure(&figure);
    }
    write_named(page, &report.render(), Format::Html)
}

/// States where and why a replay with other files ends.
fn end(experiment: &Experiment, replayed: &ReplayReport) -> String {
    let ReplayReport { compared, logged, outcome, .. } = replayed;
    let reason = match (&outcome.fault, outcome.interrupted) {
        (Some(fault), _) => {
            let at = outcome.time_s.map_or_else(String::new, |s| format!(" at {s:.3} s of control"));
            format!("it would have been stopped{at}: {fault}")
        }
        (None, false) => format!("its duration of {} s is over", experiment.duration_s()),
        (None, true) if compared < logged => "a stop was requested in the log".to_owned(),
        (None, true) => "the log ends".to_owned(),
    };
    format!("It ends after {compared} of {logged} ticks: {reason}.")
}

/// Relative difference up to which numbers differ in their last bits.
const LAST_BITS: f64 = 1e-13;

/// Cause of a difference in the last bits, beside a change of the program.
const OTHER_MACHINE: &str = "  The first difference is one of the last bits: another processor or C library computes them \
                             differently (docs/howto/logs.md).\n";

fn differs_in_last_bits(difference: &Difference) -> bool {
    let Difference { logged, recomputed, .. } = difference;
    (logged - recomputed).abs() <= LAST_BITS * logged.abs().max(recomputed.abs())
}

/// Describes the result of a replay: equality of all bits, or the first difference.
fn verdict(log: &Path, replayed: &ReplayReport) -> String {
    let (log, ReplayReport { compared, logged, differing, .. }) = (log.display(), replayed);
    match &replayed.first_difference {
        Some(d) => format!(
            "{log}: differs in {differing} of {compared} ticks, first at tick {} ({:.6} s): \
             {} of '{}' was {:?}, is {:?}\n{}",
            d.tick,
            d.time_s,
            d.signal,
            d.element,
            d.logged,
            d.recomputed,
            if differs_in_last_bits(d) { OTHER_MACHINE } else { "" },
        ),
        None if !replayed.unmatched.is_empty() => format!(
            "{log}: the signals differ: only the log or only the replay has {}\n",
            replayed.unmatched.join(", ")
        ),
        None if compared < logged => format!("{log}: the replay ended after {compared} of {logged} ticks\n"),
        None if *logged == 0 => format!("{log}: no ticks to compare\n"),
        None => format!("{log}: all {compared} ticks are equal, bit for bit\n"),
    }
}

/// Describes the commands that another task would have computed.
fn what_if_text(
    experiment: &Experiment,
    recording: &Recording,
    replayed: &ReplayReport,
    summary: &Summary,
) -> String {
    let (name, compared) = (experiment.task().name(), replayed.compared);
    let mut text = format!(
        "open loop: commands of '{name}' computed from the logged measurements, over {compared} ticks\n"
    );
    text += &format!("{}\n", end(experiment, replayed));
    if let Some(replay) = &summary.replay {
        text += &format!("{}\n", replay.text());
    }
    summary.findings.iter().for_each(|finding| text += &note(finding));
    let tick = recording.channel(TICK_CHANNEL);
    for (signal, elements) in &replayed.rms {
        let units = tick.and_then(|tick| tick.signal(signal)).map_or(&[][..], |column| column.units());
        for ((element, rms), unit) in elements.iter().zip(units) {
            text += &format!("  {signal} of '{element}': {rms:.6} {unit} rms difference from the log\n");
        }
    }
    text
}

fn as_json(
    log: &Path,
    experiment: &Experiment,
    recording: &Recording,
    replayed: &ReplayReport,
    open_loop: bool,
) -> Value {
    let first = replayed.first_difference.as_ref().map(|d| {
        json!({
            "tick": d.tick,
            "time_s": d.time_s,
            "signal": d.signal,
            "element": d.element,
            "logged": d.logged,
            "recomputed": d.recomputed,
        })
    });
    let rms: Map<String, Value> = (replayed.rms.iter())
        .map(|(signal, elements)| {
            let elements = elements.iter().map(|(element, rms)| (element.clone(), json!(rms)));
            (signal.clone(), Value::Object(elements.collect()))
        })
        .collect();
    json!({
        "schema": "opspace.replay/1",
        "log": log,
        "task": experiment.task().name(),
        "open_loop": open_loop,
        "end": open_loop.then(|| end(experiment, replayed)),
        "ticks_logged": replayed.logged,
        "ticks_compared": replayed.compared,
        "ticks_differing": replayed.differing,
        "first_difference": first,
        "unmatched_signals": replayed.unmatched,
        "rms_difference": rms,
        "damage": recording.damage.as_ref().map(ToString::to_string),
        "rows_lost": recording.dropped(),
    })
}
