//! `opspace bench`: runs a suite and prints one table.

use crate::cli::BenchArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::interrupt;
use crate::outputs::check_outputs;
use crate::plant::open_plants;
use crate::result_folder::{ROWS, empty};
use crate::shard::ShardChoice;
use crate::suite_results::SuiteResults;
use crate::sweep::{Sweep, log_names, print_start};
use opspace_experiment::Progress;
use opspace_experiment::files::origin::PAPER_SUITE;
use opspace_experiment::run::result_files::{REPORT, ResultFolder, remove_leftovers};
use opspace_experiment::{Extensions, Files, RunError, RunSummary, Scenario};
use opspace_suite::Suite;
use opspace_suite::baseline::RunKey;
use opspace_suite::shard::Shard;
use opspace_suite::suite_rows::{SUITE_ROWS, SuiteHeader, SuiteRows};
use std::collections::BTreeMap;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

pub fn bench(args: &BenchArgs, extensions: &Extensions, console: Console) -> Outcome {
    let (suite, name) = match &args.suite {
        Some(path) => {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            (Suite::load_allowing(extensions, Files::Disk, path, &args.allow.allow)?, format!("bench-{stem}"))
        }
        None => (Suite::load(Files::Embedded, Path::new(PAPER_SUITE))?, "bench".to_owned()),
    };
    let suite = suite.on_plants(&open_plants(&args.plants, extensions)?)?;
    let shard = args.shard.map(ShardChoice::resolve).transpose()?;
    let header = SuiteHeader::new(&suite, &name, shard);
    if suite.has_several_robots() {
        refuse_options_of_tasks(args)?;
    }
    let baseline = args.results.check()?;
    let single = header.numbers().filter_map(|number| suite.runs[number - 1].single());
    let keys: Vec<RunKey> = single.map(RunKey::of_experiment).collect();
    if baseline.as_ref().is_some_and(|baseline| !keys.is_empty() && !baseline.has_any(&keys)) {
        return Err(args.results.refuse_foreign());
    }
    let results = execute(&suite, header, args, console)?;
    let exit = results.write(&args.results, baseline.as_ref(), extensions, console)?;
    args.open.show(&results.folder.path().join(REPORT), console);
    Ok(results.ended(exit, console))
}

/// Refuses options that a suite of experiments with several robots does not have.
fn refuse_options_of_tasks(args: &BenchArgs) -> Result<(), Failure> {
    let given = [
        ("--shard", args.shard.is_some(), "run the whole suite, or write several suite files"),
        ("--baseline", args.results.baseline.is_some(), "compare the files of --csv"),
    ];
    match given.into_iter().find(|(_, is_given, _)| *is_given) {
        None => Ok(()),
        Some((option, _, help)) => {
            let text = format!(
                "{option} is for suites of tasks; this one has experiments with several robots: {help}"
            );
            Err(Failure::Other(text, Exit::Bad))
        }
    }
}

/// Executes the runs of a suite, or those that an earlier process has not completed.
fn execute(
    suite: &Suite,
    header: SuiteHeader,
    args: &BenchArgs,
    console: Console,
) -> Result<SuiteResults, Failure> {
    let shard = header.shard;
    let mut logs = log_names(&suite.runs);
    logs.retain(|&number, _| shard.is_none_or(|shard| shard.contains(number)));
    let folder = folder_of(args.results.output.out.as_deref(), &header.name, shard);
    let files: Vec<String> =
        logs.values().cloned().chain([REPORT, ROWS, SUITE_ROWS].map(str::to_owned)).collect();
    let mut inputs: Vec<PathBuf> = suite.runs.iter().flat_map(Scenario::input_paths).collect();
    inputs.push(suite.source.name().into());
    let mut outputs: Vec<PathBuf> = files.iter().map(|name| folder.join(name)).collect();
    outputs.extend(args.results.outputs());
    check_outputs(&inputs, &outputs)?;
    check_outputs(args.results.baseline.as_slice(), &args.results.overwritten(&files))?;

    let watch = interrupt::watch();
    let locked = lock(&folder, shard.is_some(), &watch, console)?;
    remove_leftovers(&locked);
    let (locked, mut rows) = match continued(&locked, &header, &logs, args.results.output.force) {
        Some(rows) => (locked, rows),
        None => {
            let chosen = args.results.output.out.is_some();
            let folder = empty(locked, chosen, args.results.output.force, &files, console)?;
            (folder, SuiteRows::new(header))
        }
    };
    let folder = locked.path();
    let pending = rows.missing();
    let mut interrupted = BTreeMap::new();
    let file = rows.append_to(folder).map_err(|e| Failure::io("cannot be written", folder, &e))?;
    if !pending.is_empty() {
        let jobs = args
            .jobs
            .map_or_else(|| std::thread::available_parallelism().map_or(1, NonZero::get), usize::from);
        let sweep = Sweep { runs: &suite.runs, logs: &logs, folder, watch: &watch, console };
        print_start(&suite.runs, &rows, &pending, jobs, console);
        for row in sweep.run(&pending, jobs, &file)? {
            // A run that was interrupted is repeated when the suite is continued.
            if row.row.is_interrupted() {
                interrupted.insert(row.run, row.row);
            } else {
                rows.rows.insert(row.run, row);
            }
        }
        if rows.rows.is_empty() && interrupted.is_empty() {
            let text = "interrupted before the first run was complete".to_owned();
            return Err(Failure::Other(text, Exit::Interrupted));
        }
        // In the order of the suite, and whole, whatever another process has appended.
        rows.append_to(folder).map_err(|e| Failure::io("cannot be written", folder, &e))?;
    } else {
        console.note(&format!("{}: all {} runs are complete", folder.display(), rows.rows.len()));
    }
    let mut all: BTreeMap<usize, RunSummary> =
        rows.rows.iter().map(|(&number, row)| (number, row.row.clone())).collect();
    all.extend(interrupted);
    Ok(SuiteResults { folder: locked, rows, summaries: all.into_values().collect(), partial: false })
}

/// Folder of the results: the one that the user named or that of the suite, and in it that of the shard.
fn folder_of(out: Option<&Path>, name: &str, shard: Option<Shard>) -> PathBuf {
    let runs = Path::new("runs");
    match shard {
        None => out.map_or_else(|| runs.join(name), Path::to_owned),
        Some(shard) => {
            let all = out.map_or_else(|| runs.join(format!("{name}-shards")), Path::to_owned);
            all.join(format!("shard-{}-of-{}", shard.index(), shard.count()))
        }
    }
}

/// Locks the folder. With `wait`, waits for a process that has locked it: the rest of a job that was killed and started
/// again, for example.
fn lock(folder: &Path, wait: bool, watch: &Progress, console: Console) -> Result<ResultFolder, Failure> {
    let mut said = false;
    loop {
        match ResultFolder::open(folder) {
            Err(RunError::Locked { .. }) if wait => {
                if watch.interrupt.load(Ordering::Relaxed) {
                    let text = format!("{}: interrupted while waiting for another opspace", folder.display());
                    return Err(Failure::Other(text, Exit::Interrupted));
                }
                if !said {
                    console.note(&format!(
                        "{}: waiting for another opspace that is writing here",
                        folder.display()
                    ));
                }
                said = true;
                std::thread::sleep(Duration::from_millis(200));
            }
            other => return Ok(other?),
        }
    }
}

/// Rows of an earlier process that this one continues: of the same suite, part and version, and not yet complete. A part
/// that is complete is continued too, without any run: batch systems start some parts twice.
fn continued(
    folder: &ResultFolder,
    header: &SuiteHeader,
    logs: &BTreeMap<usize, String>,
    force: bool,
) -> Option<SuiteRows> {
    let path = folder.path();
    if force || (header.shard.is_none() && path.join(ROWS).exists()) {
        return None;
    }
    let mut rows = SuiteRows::read(path).filter(|rows| rows.header == *header)?;
    rows.rows.retain(|number, row| {
        row.log.as_ref() == logs.get(number) && row.log.as_ref().is_none_or(|log| path.join(log).exists())
    });
    Some(rows)
}
