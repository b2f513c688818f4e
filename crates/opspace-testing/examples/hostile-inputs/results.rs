//! Folders of results whose files are changed or removed: the suite is continued, and its parts are merged.

use crate::Outcome;
use crate::byte_changes::changed;
use crate::inputs::{Inputs, copy, write};
use crate::program::tail;
use opspace_testing::random::Random;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Keys of bench.json with computing times.
const TIMES: [&str; 2] = ["timing", "realtime_factor"];

pub fn result(inputs: &Inputs, random: &mut Random, folder: &Path) -> Outcome {
    try_results(inputs, random, folder).unwrap_or_else(Outcome::Failed)
}

fn try_results(inputs: &Inputs, random: &mut Random, folder: &Path) -> Result<Outcome, String> {
    copy(&inputs.results, folder)?;
    let out = folder.join("out");
    let rows = out.join("rows.jsonl");
    let bytes = fs::read(&rows).map_err(|error| error.to_string())?;
    let is_cut = random.is(0.5);
    let changed = if is_cut { bytes[..random.below(bytes.len())].to_vec() } else { changed(&bytes, random) };
    write(&rows, &changed)?;
    // Without it, the suite was cut off.
    if is_cut || random.is(0.5) {
        drop(fs::remove_file(out.join("bench.json")));
    }
    let merged = inputs.program.run(folder, &["merge", "out", "--out", "merged"])?;
    let continued = inputs.program.run(folder, &["bench", "suite.toml", "--out", "out"])?;
    if continued.code == 2 {
        return Ok(Outcome::Refused);
    }
    if is_cut {
        compare(&inputs.results.join("out"), &out, &continued.said)?;
    }
    Ok(if merged.code == 2 { Outcome::Accepted } else { Outcome::Ran })
}

/// Compares bench.json of two folders, without computing times.
///
/// # Errors
/// The words of the program, if they differ.
pub fn compare(one: &Path, other: &Path, said: &str) -> Result<(), String> {
    let of = |folder: &Path| -> Result<Value, String> {
        let text = fs::read_to_string(folder.join("bench.json"))
            .map_err(|error| format!("bench.json: {error}: {}", tail(said)))?;
        let mut value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
        remove_times(&mut value);
        Ok(value)
    };
    if of(one)? == of(other)? {
        Ok(())
    } else {
        Err(format!("bench.json differs from the uninterrupted one: {}", tail(said)))
    }
}

fn remove_times(value: &mut Value) {
    match value {
        Value::Object(map) => {
            map.retain(|key, _| !TIMES.contains(&key.as_str()));
            map.values_mut().for_each(remove_times);
        }
        Value::Array(list) => list.iter_mut().for_each(remove_times),
        _ => {}
    }
}
