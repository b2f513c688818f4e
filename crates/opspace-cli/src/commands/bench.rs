//! `opspace bench`: runs a suite and prints one table.

use crate::cli::BenchArgs;
use crate::commands::run::{exit_code, style};
use crate::console::{Console, Exit, Failure, Outcome, results};
use crate::interrupt;
use crate::output::{REPORT, ROWS, prepare, pretty, write};
use indicatif::ProgressBar;
use opspace_experiment::Progress;
use opspace_experiment::files::origin::PAPER_SUITE;
use opspace_experiment::report::document::{RunSection, page};
use opspace_experiment::{Experiment, Extensions, Files, RunError, Suite, Summary};
use opspace_log::Recording;
use serde_json::json;
use std::collections::BTreeSet;
use std::io::Cursor;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Results of a run.
struct Done {
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
    let folder = prepare(&args.output, &PathBuf::from("runs").join(name), console)?;
    let watch = interrupt::watch();
    let jobs =
        args.jobs.map_or_else(|| std::thread::available_parallelism().map_or(1, NonZero::get), usize::from);
    let done = run_all(&suite.experiments, jobs, &watch, console)?;

    let summaries: Vec<Summary> = done.iter().map(|d| d.summary.clone()).collect();
    let mut shown = Vec::new();
    for Done { shown: one, .. } in done {
        let Some((one, log)) = one else { continue };
        let name = format!("{}-{}", one.summary.task, one.summary.backend);
        // Two tasks of a suite can have the same name.
        let same = shown.iter().filter(|s: &&RunSection| s.summary.task == one.summary.task).count();
        let path =
            folder.join(if same == 0 { format!("{name}.mcap") } else { format!("{name}-{}.mcap", same + 1) });
        std::fs::write(&path, log).map_err(|e| Failure::io("cannot be written", &path, &e))?;
        shown.push(one);
    }
    let rows = json!({
        "schema": "opspace.bench/1",
        "opspace_version": env!("CARGO_PKG_VERSION"),
        "rows": summaries,
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
    let shown = shown(experiments);
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
                    let result = run_one(experiment, shown.contains(&index), watch);
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

/// Indices of the runs that are shown in the report and whose logs are kept: the first run of each task.
fn shown(experiments: &[Experiment]) -> BTreeSet<usize> {
    let mut tasks = BTreeSet::new();
    (0..experiments.len()).filter(|&i| tasks.insert(experiments[i].task().source.name().to_owned())).collect()
}

fn run_one(experiment: &Experiment, shown: bool, watch: &Progress) -> Result<Done, RunError> {
    let finished = experiment.run(Cursor::new(Vec::new()), watch)?;
    let log = finished.sink.into_inner();
    let recording = Recording::from_bytes(&log)?;
    let summary = experiment.summary(&recording, &finished.record, Some(finished.realtime_factor));
    let shown = shown.then(|| (RunSection::new(experiment, &recording, summary.clone()), log));
    Ok(Done { summary, shown })
}
