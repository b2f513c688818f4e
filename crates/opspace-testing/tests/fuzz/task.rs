//! Task files.

use crate::edits::{apply_to_text, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::messages::check_error;
use crate::{CORPUS, files, root, text};
use bolero::ValueGenerator;
use opspace_backend::CommandKind;
use opspace_experiment::files::overrides;
use opspace_experiment::files::source::FileError;
use opspace_experiment::run::replay::replay;
use opspace_experiment::{
    ControllerKind, Experiment, Files, Progress, RobotDefinition, RunOptions, Scenario, Source,
    TaskDefinition,
};
use opspace_log::Recording;
use opspace_preflight::diagnostics;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 256 << 20;

/// Settings for a run of a few cycles.
const SHORT: [&str; 2] = ["settle_s=0", "duration_s=0.03"];

/// Robots and controllers that do most tasks.
const OPTIONS: [(CommandKind, ControllerKind); 4] = [
    (CommandKind::Position, ControllerKind::Osc),
    (CommandKind::Torque, ControllerKind::Osc),
    (CommandKind::Position, ControllerKind::Ik),
    (CommandKind::Position, ControllerKind::IkLead),
];

/// One of so many accepted tasks is also diagnosed, and one is run: that takes longer than reading.
const RARELY: u8 = 8;

/// An error names the task file, a recorded path or the robot. The diagnostics of an accepted task have texts. A short
/// run of it ends with finite commands, and the replay of its log gives the same bits.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn task() {
    let paths = [files("tasks", ".toml"), files(CORPUS, ".task.toml")].concat();
    let seeds: Vec<String> = paths.iter().map(|path| text(path)).collect();
    let robots: BTreeMap<PathBuf, RobotDefinition> = crate::robot::ROBOTS
        .map(|name| root(&format!("robots/{name}")))
        .map(|path| (path.clone(), RobotDefinition::load(Files::Disk, &path, &[]).expect("a robot")))
        .into();
    let target = Target::new("task", MOST_BYTES);
    let generator = (edited(seeds.len()), 0..OPTIONS.len(), 0..RARELY)
        .map_gen(|((seed, edits), options, more)| (seed, edits, options, more));
    for_each_input(generator, 500, |(seed, edits, options, more)| {
        let text = apply_to_text(&seeds, *seed, edits);
        target.check(text.as_bytes(), false, || {
            let name = root("tasks/fuzz.toml").display().to_string();
            let mut recordings = Vec::new();
            match experiment(Source::new(name.as_str(), text.as_str()), &robots, *options, &mut recordings) {
                Ok(experiment) => {
                    check_experiment(&experiment, *more);
                    true
                }
                Err(error) => {
                    let robot = error.path().ends_with("robot.toml").then(|| error.path().to_owned());
                    let names: Vec<String> = [name].into_iter().chain(recordings).chain(robot).collect();
                    check_error(&error, &names.iter().map(String::as_str).collect::<Vec<_>>());
                    false
                }
            }
        });
    });
}

fn experiment(
    source: Source,
    robots: &BTreeMap<PathBuf, RobotDefinition>,
    options: usize,
    recordings: &mut Vec<String>,
) -> Result<Experiment, FileError> {
    let task = TaskDefinition::from_sources(source, |named| {
        recordings.push(named.path.display().to_string());
        Source::read(named.path)
    })?;
    let default = &robots[&root("robots/panda")];
    let robot = robots.get(&task.robot_path()).unwrap_or(default).clone();
    let (backend, controller) = OPTIONS[options];
    let options = RunOptions { backend, controller, ..RunOptions::default() };
    Experiment::new(robot, task, options, Vec::new())
}

fn check_experiment(experiment: &Experiment, more: u8) {
    assert!(experiment.duration_s().is_finite() && experiment.duration_s() > 0.0);
    assert!(experiment.controller().is_ok());
    match more {
        0 => {
            for diagnostic in diagnostics(experiment) {
                assert!(!diagnostic.message.is_empty() && !diagnostic.help.is_empty(), "{diagnostic:?}");
            }
        }
        1 => check_run(experiment),
        _ => {}
    }
}

/// Runs an experiment for a few cycles.
fn check_run(experiment: &Experiment) {
    let settings = SHORT.map(str::to_owned);
    let Ok(source) = overrides::apply(&experiment.task().source, &settings) else { return };
    let task = TaskDefinition::from_sources(source, |named| Source::read(named.path));
    let Ok(task) = task else { return };
    let (robot, options) = (experiment.robot().clone(), experiment.options().clone());
    let Ok(experiment) = Experiment::new(robot, task, options, Vec::new()) else { return };
    let mut recording = Recording::default();
    let results = Scenario::from(experiment.clone())
        .run_in_segments(&Progress::default(), |_, segment, _| recording = segment.clone())
        .unwrap_or_else(|error| panic!("{error}"));
    let (record, _) = &results[0];
    let tick = recording.tick().expect("a run");
    let command = tick.signal("command").expect("a command");
    // A row without a command has no number at all.
    let is_command = |row: &[f64]| row.iter().all(|x| x.is_finite()) || row.iter().all(|x| x.is_nan());
    let is_overflow = record.fault.as_ref().is_some_and(|fault| fault.contains("not a finite number"));
    assert!(!is_overflow, "{record:?}");
    for (row, time_s) in command.rows().zip(&tick.time_s) {
        assert!(is_command(row), "the command {row:?} at {time_s} s: {:?}", record);
    }
    let report = replay(&experiment, &recording).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((report.compared, report.differing), (tick.len(), 0), "{:?}", report.first_difference);
}
