//! `opspace bench`: runs a suite and prints one table.

use crate::cli::BenchArgs;
use crate::commands::run::{exit_code, style};
use crate::console::{Console, Exit, Failure, Outcome, results};
use crate::interrupt;
use crate::output::{pretty, write};
use crate::result_folder::{LOGS, ROWS, prepare};
use indicatif::ProgressBar;
use opspace_experiment::Progress;
use opspace_experiment::files::origin::PAPER_SUITE;
use opspace_experiment::report::document::{RunSection, page};
use opspace_experiment::run::folder::REPORT;
use opspace_experiment::{Experiment, Extensions, Files, RunError, Suite, Summary};
use opspace_log::Recording;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Results of a run.
struct Done {
    /// Index of its experiment in the suite.
    index: usize,
    summary: Summary,
    shown: Option<(RunSection, Vec<u8>)>,
}

pub fn bench(args: &BenchArgs, extensions: &Extensions, console: Console) -> Outcome {
    let (suite, name) = match &args.suite {
        Some(path) => {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            (Suite::load_with(extensions, Files::Disk, path)?, format!("bench-{stem}"))
        }
        None => (Suite::load(Files::Embedded, Path::new(PAPER_SUITE))?, "bench".to_owned()),
    };
    let logs = log_names(&suite.experiments);
    let files: Vec<String> = logs.values().cloned().chain([REPORT, ROWS].map(str::to_owned)).collect();
    let mut inputs: Vec<PathBuf> = suite.experiments.iter().flat_map(Experiment::input_paths).collect();
    inputs.push(suite.source.name().into());
    let results_folder = prepare(&args.output, &PathBuf::from("runs").join(name), &files, &inputs, console)?;
    let folder = results_folder.path();
    let watch = interrupt::watch();
    let jobs =
        args.jobs.map_or_else(|| std::thread::available_parallelism().map_or(1, NonZero::get), usize::from);
    let done = run_all(&suite.experiments, &logs, jobs, &watch, console)?;

    let summaries: Vec<Summary> = done.iter().map(|d| d.summary.clone()).collect();
    let mut shown = Vec::new();
    let mut written = Vec::new();
    for Done { index, shown: one, .. } in done {
        let (Some((one, log)), Some(name)) = (one, logs.get(&index)) else { continue };
        let path = folder.join(name);
        std::fs::write(&path, log).map_err(|e| Failure::io("cannot be written", &path, &e))?;
        written.push(name);
        shown.push(one);
    }
    let rows = json!({
        "schema": "opspace.bench/1",
        "opspace_version": env!("CARGO_PKG_VERSION"),
        "rows": summaries,
        (LOGS): written,
    });
    let rows = pretty(&rows);
    let lead = format!("{} runs in simulation. {}", summaries.len(), LEAD);
    write(&folder.join(REPORT), &page(&suite.title, &lead, &summaries, &suite.columns, &shown))?;
    write(&folder.join(ROWS), &rows)?;
    args.output.json.print(|| rows.clone(), || results(console, &summaries, &suite.columns))?;
    console.note(&format!("wrote {}, {ROWS} and {} logs", folder.join(REPORT).display(), shown.len()));
    let codes: Vec<Exit> = summaries.iter().map(exit_code).collect();
    let worst = [Exit::Failed, Exit::Interrupted, Exit::DataLost].into_iter().find(|e| codes.contains(e));
    Ok(worst.unwrap_or(Exit::Done))
}

const LEAD: &str = "Each task file runs unchanged on position and velocity robots through a transformer, which converts \
                    desired torques into setpoints (commands of position or velocity servos), on a torque robot, and on \
                    a position robot by inverse kinematics (ik). The profile is the set of servo parameters and rates; \
                    1:5 means a setpoint every five servo ticks. The operator is a simulated person whose hand pulls at \
                    the robot.";

/// Runs the experiments in parallel, each on one thread; the results are in the order of the experiments.
fn run_all(
    experiments: &[Experiment],
    logs: &BTreeMap<usize, String>,
    jobs: usize,
    watch: &Progress,
    console: Console,
) -> Result<Vec<Done>, Failure> {
    let bar = if console.shows_progress() {
        ProgressBar::new(experiments.len() as u64)
    } else {
        ProgressBar::hidden()
    };
    bar.set_style(style("{pos:>4}/{len} {wide_bar} {elapsed} {msg}"));
    let next = AtomicUsize::new(0);
    let results: Vec<Mutex<Option<Result<Done, RunError>>>> =
        experiments.iter().map(|_| Mutex::new(None)).collect();
    std::thread::scope(|scope| {
        for _ in 0..jobs.min(experiments.len()) {
            scope.spawn(|| {
                while !watch.interrupt.load(Ordering::Relaxed) {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(experiment) = experiments.get(index) else { return };
                    bar.set_message(experiment.task().name());
                    let result = run_one(index, experiment, logs.contains_key(&index), watch);
                    if let Ok(mut slot) = results[index].lock() {
                        *slot = Some(result);
                    }
                    bar.inc(1);
                }
            });
        }
    });
    bar.finish_and_clear();
    let mut done = Vec::new();
    for slot in results {
        // An empty slot belongs to a run that did not start because of an interrupt.
        if let Some(result) = slot.into_inner().unwrap_or_default() {
            done.push(result?);
        }
    }
    if done.is_empty() {
        return Err(Failure::Other(
            "interrupted before the first run was complete".to_owned(),
            Exit::Interrupted,
        ));
    }
    Ok(done)
}

/// File names of the logs that are kept, by the index of the run: the first run of each task, which is drawn too.
fn log_names(experiments: &[Experiment]) -> BTreeMap<usize, String> {
    let (mut tasks, mut names, mut logs) = (BTreeSet::new(), BTreeSet::new(), BTreeMap::new());
    for (index, experiment) in experiments.iter().enumerate() {
        if !tasks.insert(experiment.task().source.name()) {
            continue;
        }
        let name = format!("{}-{}", experiment.task().name(), experiment.options().backend.name());
        // Two tasks of a suite may have one name.
        let free = (1..).map(|k| if k == 1 { format!("{name}.mcap") } else { format!("{name}-{k}.mcap") });
        logs.extend(free.into_iter().find(|name| names.insert(name.clone())).map(|name| (index, name)));
    }
    logs
}

fn run_one(index: usize, experiment: &Experiment, shown: bool, watch: &Progress) -> Result<Done, RunError> {
    if !shown {
        let run = experiment.run_in_memory(watch)?;
        let summary = experiment.summary(&run.recording, &run.record, Some(run.realtime_factor));
        return Ok(Done { index, summary, shown: None });
    }
    let finished = experiment.run(Cursor::new(Vec::new()), watch)?;
    let log = finished.sink.into_inner();
    let recording = Recording::from_bytes(&log)?;
    let summary = experiment.summary(&recording, &finished.record, Some(finished.realtime_factor));
    let section = RunSection::new(experiment, &recording, summary.clone());
    Ok(Done { index, summary, shown: Some((section, log)) })
}
