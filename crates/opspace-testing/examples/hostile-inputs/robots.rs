//! Robot files and URDFs, with a task of the unchanged robot. A robot that `check` accepts by itself is not refused by `run`
//! because of its own file; a task may not suit it any more.

use crate::Outcome;
use crate::inputs::{Inputs, Seed, changed_text, changed_toml, text, write};
use crate::library::read;
use crate::program::tail;
use crate::tasks::run_and_check;
use opspace_experiment::{Files, RobotDefinition};
use opspace_testing::random::Random;
use std::path::Path;

/// Share of the accepted and of the refused files that the program gets.
const SHARE_OF_ACCEPTED: f64 = 0.8;
const SHARE_OF_REFUSED: f64 = 0.15;

pub fn robot(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    let seed = random.below(inputs.names.len());
    let changed = changed_toml(&inputs.robots, seed, random);
    judge(inputs, seed, &changed, inputs.urdfs[seed].text.as_bytes(), random, folder)
}

pub fn urdf(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    let seed = random.below(inputs.names.len());
    let changed = changed_text(&inputs.urdfs, seed, random);
    judge(inputs, seed, inputs.robots[seed].text.as_bytes(), &changed, random, folder)
}

fn judge(
    inputs: &Inputs,
    seed: usize,
    robot: &[u8],
    urdf: &[u8],
    random: &mut Random,
    folder: &Path,
) -> Outcome {
    let written = write(&folder.join("robot.toml"), robot)
        .and_then(|()| write(&folder.join(format!("{}.urdf", inputs.names[seed])), urdf));
    written.and_then(|()| try_robot(inputs, seed, random, folder)).unwrap_or_else(Outcome::Failed)
}

fn try_robot(inputs: &Inputs, seed: usize, random: &mut Random, folder: &Path) -> Result<Outcome, String> {
    let is_accepted = read(&text(folder), || RobotDefinition::load(Files::Disk, folder, &[]))?.is_ok();
    if !random.is(if is_accepted { SHARE_OF_ACCEPTED } else { SHARE_OF_REFUSED }) {
        return Ok(if is_accepted { Outcome::Accepted } else { Outcome::Refused });
    }
    let name = format!("robots/{}\"", inputs.names[seed]);
    let tasks: Vec<&Seed> = inputs.tasks.iter().filter(|task| task.text.contains(&name)).collect();
    let task = text(&tasks[random.below(tasks.len())].path);
    let robot = text(folder);
    let check = inputs.program.run(folder, &["check", &robot])?;
    if check.code == 0 && !is_accepted {
        return Err(format!("check accepts what the reader refuses: {}", tail(&check.said)));
    }
    let outcome = run_and_check(inputs, &[&task, "--robot", &robot], random, folder)?;
    if check.code == 0 && matches!(outcome, Outcome::Refused) {
        let settings = ["--set", "duration_s=0.05", "--set", "settle_s=0"];
        let run =
            inputs.program.run(folder, &[&["run", &task, "--robot", &robot], &settings[..]].concat())?;
        // Servos that a transformer cannot invert are no mistake of the robot, and a real one needs no [simulated].
        let is_of_robot = ["transformer = ", "[not-simulated]"].iter().all(|words| !run.said.contains(words));
        if is_of_robot && run.said.contains(&format!("error: {robot}/robot.toml")) {
            return Err(format!("check accepts the robot, but not run: {}", tail(&run.said)));
        }
    }
    Ok(outcome)
}
