//! `opspace check`: files, and files against each other, without running anything.

use crate::cli::CheckArgs;
use crate::console::{Console, Exit, Outcome, report};
use crate::output::pretty;
use opspace_experiment::files::Kind;
use opspace_experiment::robot::load_urdf;
use opspace_experiment::{Choice, Experiment, FileError, Files, Robot, Source, Suite};
use opspace_model::{Model, UrdfOptions, UrdfWarning, suspicions};
use serde_json::{Value, json};
use std::path::Path;

pub fn check(args: &CheckArgs, console: Console) -> Outcome {
    let mut exit = Exit::Done;
    let (mut text, mut files) = (String::new(), Vec::new());
    for path in &args.files {
        let checked = check_one(path, console);
        files.push(as_json(path, &checked));
        match checked {
            Ok(what) => text += &format!("{}: {what}\n", path.display()),
            Err(error) => exit = report(&error.into()),
        }
    }
    args.json.print(|| pretty(&json!({ "schema": "opspace.check/1", "files": files })), || text)?;
    Ok(exit)
}

/// What in a URDF, or in the model that it makes, deserves a second look.
fn warn(console: Console, urdf: &str, warnings: &[UrdfWarning], model: &Model) {
    warnings.iter().for_each(|w| console.note(&format!("{urdf}: {w}")));
    suspicions(model).iter().for_each(|s| console.note(&format!("{urdf}: {s}")));
}

fn check_one(path: &Path, console: Console) -> Result<String, FileError> {
    if path.extension().is_some_and(|e| e == "urdf") {
        let source = Source::read(path)?;
        let loaded = load_urdf(&source, UrdfOptions::default())?;
        warn(console, source.name(), &loaded.warnings, &loaded.model);
        return Ok(format!("a URDF of {} moving joints", loaded.model.n()));
    }
    let file = Files::Disk.robot_file(path);
    let source = Source::read(&file)?;
    let robot = || {
        let robot = Robot::load(Files::Disk, path, &[])?;
        warn(console, robot.urdf.name(), &robot.warnings, &robot.model);
        Ok(format!("a robot of {} joints", robot.model.n()))
    };
    match Kind::of(source.text()) {
        Some(Kind::Suite) => {
            let suite = Suite::load(Files::Disk, path)?;
            Ok(format!("a suite of {} runs", suite.experiments.len()))
        }
        Some(Kind::Task) => {
            let experiment = Experiment::load(Files::Disk, path, None, Choice::default(), &[])?;
            Ok(format!("a task for the robot '{}'", experiment.robot().name()))
        }
        Some(Kind::Robot) => robot(),
        // What a folder stands for is a robot.
        None if path.is_dir() => robot(),
        None => {
            let help = "a robot file has `urdf`, a task file has `robot` and `priority`, a suite has [[run]]";
            let message = "is neither a robot, a task nor a suite";
            Err(FileError::of_file(source.name(), message, Some(help.to_owned())))
        }
    }
}

fn as_json(path: &Path, checked: &Result<String, FileError>) -> Value {
    match checked {
        Ok(what) => json!({ "file": path, "ok": true, "is": what }),
        Err(error) => json!({
            "file": path,
            "ok": false,
            // The fault may stand in a file that this one names.
            "at": error.path(),
            "line": error.line(),
            "message": error.message(),
            "help": error.help(),
        }),
    }
}
