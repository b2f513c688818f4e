//! Suite files: those of the repository are read, and a suite of few short runs is also run.

use crate::Outcome;
use crate::inputs::{Inputs, Seed, changed_toml, text, write};
use crate::library::read;
use crate::program::tail;
use opspace_experiment::Files;
use opspace_suite::Suite;
use opspace_testing::random::Random;
use std::fs;
use std::path::Path;
use std::time::Duration;

/// Share of the inputs that are changes of the suite of few runs.
const SHARE_OF_FEW_RUNS: f64 = 0.5;

/// Share of the accepted and of the refused files that the program gets.
const SHARE_OF_ACCEPTED: f64 = 0.8;
const SHARE_OF_REFUSED: f64 = 0.15;

/// Longest duration of a suite; a change may ask for many or long runs.
const LONGEST: Duration = Duration::from_secs(20);

/// Name of the suite of few runs.
const FEW_RUNS: &str = "few-runs.toml";

pub fn suite(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    let is_few = |seed: &Seed| seed.path.ends_with(FEW_RUNS);
    let few = inputs.suites.iter().position(is_few).unwrap_or(0);
    let seed = if random.is(SHARE_OF_FEW_RUNS) { few } else { random.below(inputs.suites.len()) };
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let file = inputs.suites[seed].path.with_file_name(format!("{name}.toml"));
    let outcome = write(&file, changed_toml(&inputs.suites, seed, random))
        .and_then(|()| try_suite(inputs, &file, seed == few, random, folder))
        .unwrap_or_else(Outcome::Failed);
    drop(fs::rename(&file, folder.join("file.toml")));
    outcome
}

fn try_suite(
    inputs: &Inputs,
    file: &Path,
    is_few: bool,
    random: &mut Random,
    folder: &Path,
) -> Result<Outcome, String> {
    let is_accepted = read(&text(folder), || Suite::load(Files::Disk, file).is_ok())?;
    let untried = if is_accepted { Outcome::Accepted } else { Outcome::Refused };
    if !random.is(if is_accepted { SHARE_OF_ACCEPTED } else { SHARE_OF_REFUSED }) || is_accepted && !is_few {
        return Ok(untried);
    }
    let arguments = ["bench", &text(file), "--jobs", "1", "--out", "out", "--csv", "runs.csv"];
    let Some(ended) = inputs.program.run_within(folder, &arguments, LONGEST)? else { return Ok(untried) };
    if (ended.code == 2) == is_accepted {
        return Err(format!(
            "accepted by the reader: {is_accepted}, but bench {}: {}",
            ended.code,
            tail(&ended.said)
        ));
    }
    Ok(if is_accepted { Outcome::Ran } else { Outcome::Refused })
}
