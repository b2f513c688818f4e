//! `opspace merge`: joins the shards of a suite.

use crate::cli::MergeArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::outputs::check_outputs;
use crate::result_folder::{ROWS, prepare};
use crate::suite_results::SuiteResults;
use opspace_experiment::run::result_files::{REPORT, replace_file};
use opspace_experiment::{Extensions, RunSummary};
use opspace_model::files::open_file;
use opspace_suite::shard::Shard;
use opspace_suite::suite_rows::{SUITE_ROWS, SuiteHeader, SuiteRow, SuiteRows};
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Maximum number of missing runs that are listed.
const MAX_LISTED: usize = 20;

pub fn merge(args: &MergeArgs, extensions: &Extensions, console: Console) -> Outcome {
    let baseline = args.results.check()?;
    let shards = read_shards(&args.shards)?;
    let (rows, logs) = join(&shards)?;
    let summaries: Vec<RunSummary> = rows.rows.values().map(|row| row.row.clone()).collect();
    if let Some(baseline) = &baseline
        && baseline.compare(&RunSummary::of_single_robots(&summaries), extensions.added()).metrics.is_empty()
    {
        return Err(args.results.refuse_foreign());
    }

    let name = Path::new(&rows.header.name).file_name().unwrap_or("bench".as_ref()).to_owned();
    let files: Vec<String> =
        logs.keys().cloned().chain([REPORT, ROWS, SUITE_ROWS].map(str::to_owned)).collect();
    let mut inputs: Vec<PathBuf> = shards.iter().map(|(folder, _)| folder.join(SUITE_ROWS)).collect();
    inputs.extend(logs.values().cloned());
    let overwritten = args.results.overwritten(&files);
    check_outputs(&inputs, &overwritten)?;
    check_outputs(args.results.baseline.as_slice(), &overwritten)?;
    let locked = prepare(&args.results.output, &PathBuf::from("runs").join(name), &files, &inputs, console)?;
    let folder = locked.path().to_owned();
    let mut lost = Vec::new();
    for (name, path) in &logs {
        match open_file(path) {
            Ok(mut log) => {
                let to = folder.join(name);
                replace_file(&to, |file| io::copy(&mut log, file).map(|_| ()))
                    .map_err(|e| Failure::io("cannot be written", &to, &e))?;
            }
            Err(error) => lost.push(format!("{}: cannot be read: {error}", path.display())),
        }
    }
    rows.append_to(&folder).map_err(|e| Failure::io("cannot be written", &folder, &e))?;
    let results = SuiteResults { folder: locked, rows, summaries, partial: true };
    let exit = results.write(&args.results, baseline.as_ref(), extensions, console)?;
    lost.iter().for_each(|text| console.note(text));
    let incomplete = list_missing(&results.rows, &shards, console) || !lost.is_empty();
    Ok(if incomplete && exit == Exit::Done { Exit::DataLost } else { exit })
}

/// Reads all shards in these folders.
fn read_shards(paths: &[PathBuf]) -> Result<Vec<(PathBuf, SuiteRows)>, Failure> {
    let mut shards = Vec::new();
    for path in paths {
        for folder in folders(path)? {
            // A suite of several robots has no shards.
            let rows = SuiteRows::read(&folder).filter(|rows| !rows.header.has_several_robots());
            let rows = rows.ok_or_else(|| {
                let file = folder.join(SUITE_ROWS);
                Failure::Other(
                    format!("{}: is not a file of rows of `opspace bench`", file.display()),
                    Exit::Bad,
                )
            })?;
            shards.push((folder, rows));
        }
    }
    Ok(shards)
}

/// Joins the rows of shards, and the paths of their logs by file name.
fn join(shards: &[(PathBuf, SuiteRows)]) -> Result<(SuiteRows, BTreeMap<String, PathBuf>), Failure> {
    let Some((first, of_first)) = shards.first() else {
        return Err(Failure::Other("no shards were given".to_owned(), Exit::Bad));
    };
    let (mut rows, mut logs) = (SuiteRows::new(of_first.header.of_whole_suite()), BTreeMap::new());
    for (folder, shard) in shards {
        if !shard.header.is_of_same_suite(&of_first.header) {
            return Err(mixed((first, &of_first.header), (folder, &shard.header)));
        }
        for (&number, row) in &shard.rows {
            if let Some(log) = &row.log {
                logs.entry(log.clone()).or_insert_with(|| folder.join(log));
            }
            let other = rows.rows.insert(number, row.clone());
            if other.is_some_and(|other| !is_same(&other, row)) {
                let text = format!(
                    "{}: run {number} ({}) differs from that of another shard; it is the same run of the same suite, so \
                     the programs or the machines differ",
                    folder.display(),
                    row.row.experiment
                );
                return Err(Failure::Other(text, Exit::Failed));
            }
        }
    }
    Ok((rows, logs))
}

/// Folders with rows that a path denotes: the folder itself, or those in it, by name.
fn folders(path: &Path) -> Result<Vec<PathBuf>, Failure> {
    if path.join(SUITE_ROWS).exists() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = fs::read_dir(path).map_err(|e| Failure::io("cannot be read", path, &e))?;
    let mut inner: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    // Earlier results that were moved aside are no part of the suite.
    let is_aside =
        |folder: &PathBuf| folder.file_name().unwrap_or_default().to_string_lossy().contains(".previous");
    inner.retain(|folder| folder.join(SUITE_ROWS).exists() && !is_aside(folder));
    inner.sort();
    if inner.is_empty() {
        let text = format!("{}: has no {SUITE_ROWS}, which `opspace bench --shard` writes", path.display());
        return Err(Failure::Other(text, Exit::Bad));
    }
    Ok(inner)
}

fn mixed((a, of_a): (&Path, &SuiteHeader), (b, of_b): (&Path, &SuiteHeader)) -> Failure {
    let what = if of_a.suite_sha256 == of_b.suite_sha256 {
        format!("opspace {} and {}", of_a.opspace_version, of_b.opspace_version)
    } else {
        format!(
            "'{}' ({:.12}) and '{}' ({:.12})",
            of_a.title, of_a.suite_sha256, of_b.title, of_b.suite_sha256
        )
    };
    let text = format!(
        "{} and {} are not shards of one suite: they are results of {what}; a change of the suite, or of a task or robot \
         that it names, makes another suite",
        a.display(),
        b.display()
    );
    Failure::Other(text, Exit::Bad)
}

/// True if two rows of one run are equal except for computing times.
fn is_same(a: &SuiteRow, b: &SuiteRow) -> bool {
    let without_timing = |row: &SuiteRow| {
        let mut value = serde_json::to_value(&row.row).unwrap_or_default();
        value["timing"] = serde_json::Value::Null;
        value
    };
    without_timing(a) == without_timing(b)
}

/// Lists the runs that no shard has, with their shards; true if there are any.
fn list_missing(rows: &SuiteRows, shards: &[(PathBuf, SuiteRows)], console: Console) -> bool {
    let missing = rows.missing();
    if missing.is_empty() {
        return false;
    }
    let count = shards.iter().find_map(|(_, rows)| rows.header.shard).map(Shard::count);
    for &number in missing.iter().take(MAX_LISTED) {
        let shard = count.map_or_else(String::new, |n| format!(" (shard {}/{n})", (number - 1) % n + 1));
        console.note(&format!("missing: run {number}{shard}"));
    }
    if missing.len() > MAX_LISTED {
        console.note(&format!("missing: {} more", missing.len() - MAX_LISTED));
    }
    console.note(&format!("{} of {} runs are missing", missing.len(), rows.header.runs));
    true
}
