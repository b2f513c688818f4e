//! `opspace replay`: recomputation of every command of a log.

use crate::cli::ReplayArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::output::{log_path, pretty, read_log};
use crate::outputs::check_outputs;
use opspace_backend::signal_names::TICK_CHANNEL;
use opspace_experiment::run::replay::{ReplayReport, replay as recompute};
use opspace_experiment::{Experiment, Extensions, Files, RunError, TaskDefinition};
use opspace_log::Recording;
use serde_json::{Map, Value, json};
use std::path::Path;

pub fn replay(args: &ReplayArgs, extensions: &Extensions, console: Console) -> Outcome {
    let inputs: Vec<_> = args.task.iter().cloned().chain([log_path(&args.log)]).collect();
    check_outputs(&inputs, &Vec::from_iter(args.json.path().map(Path::to_owned)))?;
    let (log, recording) = read_log(&args.log)?;
    let bad = |error: RunError| Failure::Other(format!("{}: {error}", log.display()), Exit::Bad);
    if let Some(damage) = &recording.damage {
        console.note(&format!("{}: damaged: {damage}", log.display()));
    }
    let logged = Experiment::of_log_with(extensions, &recording).map_err(bad)?;
    let other = match &args.task {
        None => None,
        Some(path) => {
            let task = TaskDefinition::load_with(&extensions.tasks, Files::Disk, path, &[])?;
            let (robot, options) = (logged.robot().clone(), logged.options().clone());
            Some(Experiment::new(robot, task, options, Vec::new())?)
        }
    };
    let experiment = other.as_ref().unwrap_or(&logged);
    let replayed = recompute(experiment, &recording).map_err(bad)?;
    let open_loop = other.is_some();
    args.json.print(
        || pretty(&as_json(&log, experiment, &recording, &replayed, open_loop)),
        || match open_loop {
            true => what_if(experiment, &recording, &replayed),
            false => verdict(&log, &replayed),
        },
    )?;
    let differs = replayed.first_difference.is_some()
        || replayed.compared < replayed.logged
        || !replayed.unmatched.is_empty();
    Ok(if differs && !open_loop {
        Exit::Failed
    } else if recording.damage.is_some() || recording.dropped() > 0 {
        Exit::DataLost
    } else {
        Exit::Done
    })
}

/// Describes the result of a replay: equality of all bits, or the first difference.
fn verdict(log: &Path, replayed: &ReplayReport) -> String {
    let (log, ReplayReport { compared, logged, differing, .. }) = (log.display(), replayed);
    match &replayed.first_difference {
        Some(d) => format!(
            "{log}: differs in {differing} of {compared} ticks, first at tick {} ({:.6} s): \
             {} of '{}' was {:?}, is {:?}\n",
            d.tick, d.time_s, d.signal, d.element, d.logged, d.recomputed,
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
fn what_if(experiment: &Experiment, recording: &Recording, replayed: &ReplayReport) -> String {
    let (name, compared) = (experiment.task().name(), replayed.compared);
    let mut text = format!(
        "open loop: commands of '{name}' computed from the logged measurements, over {compared} ticks\n"
    );
    if compared < replayed.logged {
        text += &format!("it would have stopped there; the log has {} ticks\n", replayed.logged);
    }
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
