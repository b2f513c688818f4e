//! Settings of the command line: `--set key=value`.

use crate::edits::{apply_to_text, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::messages::check_error;
use crate::{CORPUS, root, text, texts};
use bolero::ValueGenerator;
use opspace_experiment::files::overrides::{apply, split};
use opspace_experiment::{Source, TaskDefinition};

/// Most memory for one list of settings, bytes.
const MOST_BYTES: usize = 64 << 20;

/// Largest number of settings of one input.
const MAX_SETTINGS: usize = 8;

/// Task files that are set.
const TASKS: [&str; 3] = ["tasks/panda-goals.toml", "tasks/press-wall.toml", "tasks/ur5e-recorded.toml"];

/// An error names the file or the setting. A file with settings is TOML, and the same after the last setting is applied
/// again; without settings it keeps its text; no setting is lost when those of the robot are separated.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn overrides() {
    let files = TASKS.map(|path| Source::new(root(path).display().to_string(), text(path)));
    let seeds = texts(CORPUS, ".settings");
    let target = Target::new("overrides", MOST_BYTES);
    let generator =
        (edited(seeds.len()), 0..files.len()).map_gen(|((seed, edits), file)| (seed, edits, file));
    for_each_input(generator, 400, |(seed, edits, file)| {
        let text = apply_to_text(&seeds, *seed, edits);
        // The first seeds have one setting for each line.
        let settings: Vec<String> = text.lines().take(MAX_SETTINGS).map(str::to_owned).collect();
        target.check(text.as_bytes(), false, || check_settings(&files[*file], &settings));
    });
}

fn check_settings(file: &Source, settings: &[String]) -> bool {
    let (robot, task) = split(settings, "robot");
    assert_eq!(robot.len() + task.len(), settings.len());
    assert_eq!(apply(file, &[]).expect("the file").text(), file.text());
    let checked = |error| {
        check_error(&error, &[file.name(), "--set"]);
        if error.path() == "--set" {
            let shown = error.excerpt().expect("the setting").0;
            assert!(task.iter().any(|setting| setting == shown), "{error:?}");
        }
    };
    let set = match apply(file, &task) {
        Ok(set) => set,
        Err(error) => {
            checked(error);
            return false;
        }
    };
    let value = set.text().parse::<toml::Table>().unwrap_or_else(|error| panic!("{error}: {}", set.text()));
    // The last setting is in force, and its key is found again.
    let last = &task[task.len().saturating_sub(1)..];
    let again = apply(&set, last).unwrap_or_else(|error| panic!("refused the second time: {error}"));
    let again = again.text().parse::<toml::Table>().expect("TOML");
    // As texts, because NaN is not equal to itself.
    assert_eq!(format!("{again:?}"), format!("{value:?}"), "another result when applied again: {last:?}");
    match TaskDefinition::from_sources(set, |_| Ok(Source::new("recorded.csv", RECORDED))) {
        Ok(task) => assert!(task.file.duration_s.get().is_finite()),
        Err(error) => checked(error),
    }
    true
}

/// Recorded path of every task.
const RECORDED: &str = "time_s,x_m,y_m,z_m\n0,0,0,0\n1,0.1,0,0\n";
