//! Signals during a suite, which is then continued: its results are those of the uninterrupted one, and nothing else is left.

use crate::Outcome;
use crate::inputs::{Inputs, SUITE, text, write};
use crate::program::{LONGEST, wait};
use crate::results::compare;
use opspace_testing::random::Random;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

const SIGNALS: [&str; 4] = ["-KILL", "-TERM", "-INT", "-HUP"];

/// Most signals to one suite, and the longest time before each, s.
const MOST_SIGNALS: usize = 4;
const LONGEST_BEFORE_S: f64 = 0.8;

pub fn kill(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    try_kill(inputs, random, folder).unwrap_or_else(Outcome::Failed)
}

fn try_kill(inputs: &Inputs, random: &mut Random, folder: &Path) -> Result<Outcome, String> {
    let task = text(&inputs.tree.join("tasks/planar-2-link-reach.toml"));
    let seeds = "seeds = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]";
    write(&folder.join("suite.toml"), SUITE.replace("TASK", &task).replace("seeds = [1, 2, 3]", seeds))?;
    let bench = ["bench", "suite.toml", "--out", "out"];
    for _ in 0..=random.below(MOST_SIGNALS) {
        let mut command = inputs.program.command(folder, "", &bench);
        let child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let mut child = child.map_err(|error| error.to_string())?;
        sleep(Duration::from_secs_f64(random.between(0.0, LONGEST_BEFORE_S)));
        let signal = SIGNALS[random.below(SIGNALS.len())];
        let sent =
            Command::new("kill").args([signal, &child.id().to_string()]).stderr(Stdio::null()).status();
        sent.map_err(|error| error.to_string())?;
        match wait(&mut child, LONGEST).map_err(|error| error.to_string())? {
            // Done before the signal, which then finds no process.
            Some(Some(0)) => break,
            Some(Some(130) | None) => {}
            Some(code) => return Err(format!("{signal}: exit code {code:?}")),
            None => return Err(format!("{signal}: no end after {LONGEST:?}")),
        }
    }
    let mut said = String::new();
    if !folder.join("out/bench.json").exists() {
        let ended = inputs.program.run(folder, &bench)?;
        if ended.code != 0 {
            return Err(format!("not continued: exit code {}: {}", ended.code, ended.said));
        }
        said = ended.said;
    }
    let whole = inputs.program.run(folder, &["bench", "suite.toml", "--out", "whole"])?;
    compare(&folder.join("whole"), &folder.join("out"), &(said + &whole.said))?;
    let names = |name: &str| -> Result<Vec<String>, String> {
        let entries = fs::read_dir(folder.join(name)).map_err(|error| error.to_string())?;
        let mut names: Vec<String> = entries
            .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
            .collect();
        names.sort();
        Ok(names)
    };
    let (left, expected) = (names("out")?, names("whole")?);
    if left != expected {
        return Err(format!("left in the folder: {left:?}, and without signals {expected:?}"));
    }
    Ok(Outcome::Ran)
}
