//! Disks without space, few files, and an output that accepts nothing.

use crate::Outcome;
use crate::inputs::{Inputs, SHORT, text};
use crate::program::{end, tail};
use opspace_testing::random::Random;
use std::path::Path;

pub fn disk(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    try_disk(inputs, random, folder).unwrap_or_else(Outcome::Failed)
}

/// Runs a command behind a limit. One that ends with 0 has written all of its files, so that it ends with 0 without the limit
/// too.
fn try_disk(inputs: &Inputs, random: &mut Random, folder: &Path) -> Result<Outcome, String> {
    let task = text(&inputs.tree.join("tasks/planar-2-link-reach.toml"));
    let log = text(&inputs.logs[random.below(inputs.logs.len())].0);
    let suite = text(&inputs.results.join("suite.toml"));
    let [duration, settle] = SHORT;
    let run = ["run", &task, "--set", duration, "--set", settle];
    let commands: [Vec<&str>; 9] = [
        [&run[..], &["--out", "out"]].concat(),
        [&run[..], &["--out", "out", "--json", "run.json"]].concat(),
        vec!["bench", &suite, "--out", "out", "--csv", "runs.csv"],
        vec!["report", &log, "--out", "page.html"],
        vec!["log", "recover", &log, "--out", "recovered.mcap"],
        vec!["log", "export", &log, "--out", "rows.csv"],
        vec!["log", "info", &log],
        vec!["check", &task],
        vec!["schema", "task"],
    ];
    let command = &commands[random.below(commands.len())];
    // Blocks of 512 or 1024 bytes. The signal is ignored, so that a write fails as it does on a full disk.
    let blocks = [0, 1, 4, 16, 60, 120][random.below(6)];
    let limits = [
        format!("trap '' XFSZ; ulimit -f {blocks}; "),
        format!("ulimit -n {}; ", 4 + random.below(12)),
        "exec >/dev/full; ".to_owned(),
        "exec >&-; ".to_owned(),
        "exec >/dev/full 2>/dev/full; ".to_owned(),
        "ulimit -s 512; ".to_owned(),
    ];
    let limit = &limits[random.below(limits.len())];
    let what = format!("{limit}opspace {}", command.join(" "));
    let ended = end(inputs.program.command(folder, limit, command), folder, &what)?;
    if ended.code == 1 || ended.code == 130 {
        return Err(format!("{what}: exit code {}: {}", ended.code, tail(&ended.said)));
    }
    Ok(if ended.code == 0 { Outcome::Ran } else { Outcome::Refused })
}
