//! Logs whose bytes are changed. A replay ends with 0 only if the data are those of the log; a comparison of a damaged log never
//! says that the logs are equal; a recovered log is whole.

use crate::Outcome;
use crate::byte_changes::changed;
use crate::inputs::{Inputs, text, write};
use crate::library::read;
use crate::program::tail;
use opspace_log::Recording;
use opspace_testing::random::Random;
use std::path::Path;

/// Share of the logs that are reported and exported.
const SHARE_REPORTED: f64 = 0.3;

pub fn log(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    let (original, bytes) = &inputs.logs[random.below(inputs.logs.len())];
    let changed = changed(bytes, random);
    let file = folder.join("changed.mcap");
    write(&file, &changed)
        .and_then(|()| try_log(inputs, &file, &changed, (original, bytes), random))
        .unwrap_or_else(Outcome::Failed)
}

fn try_log(
    inputs: &Inputs,
    file: &Path,
    bytes: &[u8],
    (original, original_bytes): (&Path, &[u8]),
    random: &mut Random,
) -> Result<Outcome, String> {
    let folder = file.parent().unwrap_or(file);
    let run = |arguments: &[&str]| inputs.program.run(folder, arguments);
    let file = &text(file);
    let is_equal =
        read(file, || match (Recording::from_bytes(bytes), Recording::from_bytes(original_bytes)) {
            (Ok(changed), Ok(original)) => is_equal(&changed, &original),
            _ => false,
        })?;
    let info = run(&["log", "info", file])?;
    let replay = run(&["replay", file])?;
    if replay.code == 0 && (!is_equal || info.code != 0) {
        return Err(format!("log info ends with {}, but replay with 0: {}", info.code, tail(&replay.said)));
    }
    let pair = if random.is(0.5) { [file, &text(original)] } else { [&text(original), file] };
    let difference = run(&["log", "diff", pair[0], pair[1]])?;
    let says_equal = difference.said.contains("the logs are equal");
    if (difference.code == 0 || says_equal) && (!is_equal || info.code != 0) {
        return Err(format!("log info ends with {}, but log diff: {}", info.code, tail(&difference.said)));
    }
    let recovered = run(&["log", "recover", file, "--out", "recovered.mcap"])?;
    if (recovered.code == 2) != (info.code == 2) {
        return Err(format!(
            "log info ends with {}, recover with {}: {}",
            info.code,
            recovered.code,
            tail(&recovered.said)
        ));
    }
    if recovered.code != 2 {
        let whole = run(&["log", "info", "recovered.mcap"])?;
        if whole.code != 0 {
            return Err(format!("the recovered log is not whole: {}", tail(&whole.said)));
        }
    }
    if random.is(SHARE_REPORTED) {
        let report = run(&["report", file, "--out", "page.html"])?;
        let export = run(&["log", "export", file, "--out", "rows.csv"])?;
        if (export.code == 2) != (info.code == 2) && !export.said.contains("no channel") {
            return Err(format!("log info ends with {}, but export: {}", info.code, tail(&export.said)));
        }
        if info.code == 3 && (report.code == 0 || export.code == 0) {
            let codes = format!("report ends with {}, export with {}", report.code, export.code);
            return Err(format!("the log is damaged, but {codes}: {}", tail(&report.said)));
        }
    }
    Ok(if info.code == 2 { Outcome::Refused } else { Outcome::Ran })
}

/// True if two logs have the same rows, attachments and metadata.
fn is_equal(one: &Recording, other: &Recording) -> bool {
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<u64>>();
    one.channels.len() == other.channels.len()
        && one.channels.iter().zip(&other.channels).all(|(one, other)| {
            one.layout == other.layout
                && bits(&one.time_s) == bits(&other.time_s)
                && bits(&one.rows) == bits(&other.rows)
        })
        && one.attachments == other.attachments
        && one.metadata == other.metadata
}
