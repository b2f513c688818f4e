//! `opspace replay --simulate`: a log simulated again, and compared with itself.

use crate::cli::ReplayArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::interrupt;
use crate::output::{logs_of_run, open_log, pretty};
use crate::plant::PlantChoice;
use crate::run_progress::with_bar;
use opspace_experiment::run::log_header::SCENE_FILE;
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_experiment::{Experiment, Extensions, RunError};
use opspace_log::{ChannelComparison, LogComparison, LogFile, Recording, compare_logs};
use opspace_sim::Scene;
use serde_json::{Value, json};
use std::io::Cursor;
use std::path::Path;

pub fn simulate_log(args: &ReplayArgs, extensions: &Extensions, console: Console) -> Outcome {
    let logs = logs_of_run(&args.log);
    let (mut text, mut results, mut exit) = (String::new(), Vec::new(), Exit::Done);
    for log in &logs {
        let comparison = simulated_again(log, extensions, console)?;
        let channels: Vec<_> = comparison.channels.iter().filter(|channel| !channel.wall_clock).collect();
        let differing: Vec<_> = channels.iter().filter(|channel| channel.differs()).collect();
        let messages: u64 = channels.iter().filter_map(|channel| channel.messages[0]).sum();
        text += &match differing.first() {
            None => format!(
                "{}: simulated again, all {messages} messages are equal, bit for bit\n",
                log.display()
            ),
            Some(first) => {
                exit = Exit::Failed;
                format!("{}: simulated again, {}\n", log.display(), difference(first))
            }
        };
        if comparison.is_damaged() && exit == Exit::Done {
            exit = Exit::DataLost;
        }
        results.push(json!({
            "log": log,
            "messages": messages,
            "differing_channels": differing.iter().map(|channel| &channel.topic).collect::<Vec<_>>(),
        }));
    }
    let json: Value = json!({ "schema": "opspace.replay-simulated/1", "logs": results });
    args.output.json.print(|| pretty(&json), || text)?;
    Ok(exit)
}

/// Refuses a scene that has changed since the log was written. The log has its text, but not the files that it includes.
fn check_scene(log: &Path, recording: &Recording, scene: Option<&Scene>) -> Result<(), Failure> {
    let logged = recording.attachment(SCENE_FILE).map(|file| file.data.as_slice());
    let Some(scene) = scene.filter(|scene| logged.is_some_and(|logged| logged != scene.text.as_bytes()))
    else {
        return Ok(());
    };
    let text = format!(
        "{}: the scene {} has changed since the run; restore it: the log has it as its attachment '{SCENE_FILE}'",
        log.display(),
        scene.path.display()
    );
    Err(Failure::Other(text, Exit::Bad))
}

/// Describes where two logs differ first.
fn difference(channel: &ChannelComparison) -> String {
    let topic = &channel.topic;
    match &channel.first {
        Some(first) => {
            let at_s = first.time_ns as f64 * 1e-9;
            let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "absent".to_owned());
            let [was, is] = [value(&first.values[0]), value(&first.values[1])];
            format!("differs first in {topic} at {at_s:.6} s: {} was {was}, is {is}", first.field)
        }
        None => format!("{topic} has {:?} messages in the log and when simulated again", channel.messages),
    }
}

/// Simulates the run of a log again, and compares the two logs.
fn simulated_again(log: &Path, extensions: &Extensions, console: Console) -> Result<LogComparison, Failure> {
    let (path, file) = open_log(log)?;
    if let Some(damage) = &file.recording().damage {
        console.note(&format!("{}: damaged: {damage}", path.display()));
    }
    let bad = |error: RunError| Failure::Other(format!("{}: {error}", path.display()), Exit::Bad);
    let recording = Recording::read(&path).map_err(|error| bad(error.into()))?;
    let experiment = Experiment::of_log_with(extensions, &recording).map_err(bad)?;
    let plant = experiment.plant();
    let name = plant.split(' ').next().unwrap_or(OWN_PLANT);
    let experiment = match PlantChoice::named(name, experiment.scene_path()).open(extensions)? {
        None => experiment,
        Some(engine) => {
            check_scene(&path, &recording, engine.scene())?;
            experiment.on_engine(engine)?
        }
    };
    let progress = interrupt::watch();
    let again = with_bar((&experiment.task().name(), experiment.ticks()), &progress, console, || {
        experiment.repeat(&recording, Cursor::new(Vec::new()), &progress)
    });
    let again =
        LogFile::from_bytes(again.map_err(bad)?.sink.into_inner()).map_err(|error| bad(error.into()))?;
    compare_logs(&file, &again).map_err(|(_, error)| bad(error.into()))
}
