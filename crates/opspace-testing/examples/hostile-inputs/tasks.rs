//! Task files, and experiments with several robots. What `check` accepts, `run` must not refuse; a run that ends with 0 has a
//! summary of finite numbers, and its log replays equal.

use crate::Outcome;
use crate::inputs::{Inputs, SHORT, Seed, changed_toml, text, write};
use crate::library::read;
use crate::program::{Ended, tail};
use opspace_experiment::{Extensions, Files, RunOptions, Scenario};
use opspace_testing::random::Random;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Share of the accepted and of the refused files that the program gets.
const SHARE_OF_ACCEPTED: f64 = 0.8;
const SHARE_OF_REFUSED: f64 = 0.15;

/// Share of the runs that are also checked, and that are also replayed and reported.
const SHARE_CHECKED: f64 = 0.08;
const SHARE_REPLAYED: f64 = 0.3;

pub fn task(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    judge(inputs, &inputs.tasks, random, folder)
}

pub fn experiment(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    judge(inputs, &inputs.experiments, random, folder)
}

fn judge(inputs: &Inputs, seeds: &[Seed], random: &mut Random, folder: &Path) -> Outcome {
    let seed = random.below(seeds.len());
    // Beside the original, so that its robot is found.
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let file = seeds[seed].path.with_file_name(format!("{name}.toml"));
    let outcome = write(&file, changed_toml(seeds, seed, random))
        .and_then(|()| try_file(inputs, &file, random, folder))
        .unwrap_or_else(Outcome::Failed);
    // The file stays beside the folder that is kept.
    drop(fs::rename(&file, folder.join("file.toml")));
    outcome
}

fn try_file(inputs: &Inputs, file: &Path, random: &mut Random, folder: &Path) -> Result<Outcome, String> {
    let is_accepted = read(&text(folder), || {
        Scenario::load(&Extensions::default(), Files::Disk, file, None, None, RunOptions::default(), &[])
    })?
    .is_ok();
    let share = if is_accepted { SHARE_OF_ACCEPTED } else { SHARE_OF_REFUSED };
    if !random.is(share) {
        return Ok(if is_accepted { Outcome::Accepted } else { Outcome::Refused });
    }
    run_and_check(inputs, &[&text(file)], random, folder)
}

/// Runs a task for a short time, and checks it with the same settings.
///
/// # Errors
/// Something that must not happen, in words.
pub fn run_and_check(
    inputs: &Inputs,
    arguments: &[&str],
    random: &mut Random,
    folder: &Path,
) -> Result<Outcome, String> {
    let settings = SHORT.map(|setting| ["--set", setting]).concat();
    let run = inputs.program.run(folder, &[&["run"], arguments, &settings, &["--out", "out"]].concat())?;
    let is_refused = run.code == 2;
    if is_refused || random.is(SHARE_CHECKED) {
        let check = inputs.program.run(folder, &[&["check"], arguments, &settings].concat())?;
        // A robot without [simulated] is valid, but it can only be run with its driver.
        let is_real = run.said.contains("[not-simulated]");
        if (check.code == 2) != is_refused && !is_real {
            let codes = format!("check {} but run {}", check.code, run.code);
            return Err(format!("{codes}: {}\n    {}", tail(&run.said), tail(&check.said)));
        }
    }
    if is_refused {
        return Ok(Outcome::Refused);
    }
    check_results(inputs, &run, random, folder)?;
    Ok(Outcome::Ran)
}

/// Checks the results of a run in `folder/out`.
fn check_results(inputs: &Inputs, run: &Ended, random: &mut Random, folder: &Path) -> Result<(), String> {
    let out = folder.join("out");
    let summary = fs::read_to_string(out.join("summary.json"));
    let summary = summary.map_err(|error| format!("no summary: {error}: {}", tail(&run.said)))?;
    let parsed: Value = serde_json::from_str(&summary).map_err(|error| format!("summary.json: {error}"))?;
    if !parsed.is_object() {
        return Err("summary.json is no object".to_owned());
    }
    if !random.is(SHARE_REPLAYED) {
        return Ok(());
    }
    // An experiment has a folder for each robot.
    let entries = fs::read_dir(&out).map_err(|error| error.to_string())?;
    let folders = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(|path| path.is_dir());
    for log in folders.chain([out.clone()]).map(|folder| folder.join("run.mcap")).filter(|log| log.exists()) {
        let replay = inputs.program.run(folder, &["replay", &text(&log)])?;
        if replay.code != 0 {
            return Err(format!("replay ends with {}: {}", replay.code, tail(&replay.said)));
        }
        let report =
            inputs.program.run(folder, &["report", &text(&log), "--out", "page.html", "--json", "-"])?;
        // A report has the failures of the run.
        if report.code > 1 {
            return Err(format!("report ends with {}: {}", report.code, tail(&report.said)));
        }
    }
    Ok(())
}
