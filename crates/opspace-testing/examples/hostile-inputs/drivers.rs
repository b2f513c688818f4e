//! Drivers with several faults at once, in this program with such a driver: `stop` is called, and the log replays equal.

use crate::Outcome;
use crate::inputs::{Inputs, text, write};
use crate::program::{LONGEST, tail, wait};
use opspace_testing::random::Random;
use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};

/// Name of the environment variable with the arguments of the program with the driver, one a line.
pub const ARGUMENTS: &str = "OPSPACE_HOSTILE_ARGUMENTS";

/// Exit codes of a run, which a faulty driver must not leave.
const CODES: [i32; 4] = [0, 1, 2, 3];

pub fn driver(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    try_driver(inputs, random, folder).unwrap_or_else(Outcome::Failed)
}

fn keys(random: &mut Random) -> String {
    let places = ["open", "read", "write", "stop", "every stop", "close"];
    let times = ["nan", "inf", "-inf", "-1", "0", "0.1", "1e9", "1e300", "-1e300"];
    let periods = ["nan", "0", "-0.001", "inf", "0.00100001", "0.002", "1e-300", "1e300"];
    let mut keys = vec![format!("at = {}", 1 + random.below(600))];
    if random.is(0.5) {
        keys.push(format!("panic = {:?}", places[random.below(places.len())]));
    }
    if random.is(0.4) {
        keys.push(format!("time_s = {:?}", times[random.below(times.len())]));
    }
    if random.is(0.2) {
        keys.push(format!("declared_s = {:?}", periods[random.below(periods.len())]));
    }
    if random.is(0.3) {
        keys.push(format!("spacing = {:?}", [0.0, 0.5, 0.99, 1.01, 2.0, -1.0, 1e9][random.below(7)]));
    }
    if random.is(0.2) {
        keys.push(format!("blocks_s = {:?}", [0.01, 0.3, 1.0][random.below(3)]));
    }
    if random.is(0.2) {
        keys.push("error = true".to_owned());
    }
    keys.push(format!("remote = {}", random.is(0.5)));
    keys.join(", ")
}

fn try_driver(inputs: &Inputs, random: &mut Random, folder: &Path) -> Result<Outcome, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let task =
        fs::read_to_string(root.join("tests/own-driver/swing.toml")).map_err(|error| error.to_string())?;
    let robot = text(&root.join("tests/own-driver/robot"));
    write(&folder.join("swing.toml"), task.replace("robot = \"robot\"", &format!("robot = {robot:?}")))?;
    let keys = keys(random);
    let calls = text(&folder.join("calls"));
    let driver = format!("robot.driver={{ name = \"faulty\", calls = {calls:?}, {keys} }}");
    let arguments = [
        "opspace",
        "run",
        "swing.toml",
        "--controller",
        "ik",
        "--duration-s",
        "1.5",
        "--set",
        "settle_s=0.5",
        "--out",
        "out",
        "--set",
        &driver,
    ];
    let explain = |error: std::io::Error| format!("{keys}: {error}");
    let said = File::create(folder.join("said")).map_err(explain)?;
    let program = std::env::current_exe().map_err(explain)?;
    let mut child = Command::new(program)
        .env(ARGUMENTS, arguments.join("\n"))
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(said)
        .spawn()
        .map_err(explain)?;
    let code = wait(&mut child, LONGEST).map_err(explain)?;
    let said = fs::read_to_string(folder.join("said")).unwrap_or_default();
    let code = match code {
        Some(Some(code)) if CODES.contains(&code) => code,
        other => return Err(format!("{keys}: exit code {other:?}: {}", tail(&said))),
    };
    let calls = fs::read_to_string(folder.join("calls")).unwrap_or_default();
    let has_begun = folder.join("out/run.mcap").exists();
    if has_begun && !calls.lines().any(|call| call == "stop" || call == "remote stop") {
        return Err(format!("{keys}: the robot was not stopped: {calls:?}: {}", tail(&said)));
    }
    if !has_begun {
        return Ok(Outcome::Refused);
    }
    let replay = inputs.program.run(folder, &["replay", "out"])?;
    if replay.code != 0 {
        return Err(format!("{keys}: exit code {code}, replay {}: {}", replay.code, tail(&replay.said)));
    }
    Ok(Outcome::Ran)
}
