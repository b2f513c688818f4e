//! `opspace bench`: runs a suite and prints one table.

use crate::cli::BenchArgs;
use crate::commands::run_progress::style;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::interrupt;
use crate::outputs::check_outputs;
use crate::plant::open_plants;
use crate::result_folder::{ROWS, empty};
use crate::shard::ShardChoice;
use crate::suite_results::SuiteResults;
use indicatif::ProgressBar;
use opspace_experiment::Progress;
use opspace_experiment::evaluate::baseline::RunKey;
use opspace_experiment::files::origin::PAPER_SUITE;
use opspace_experiment::run::folder::REPORT;
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_experiment::run::result_files::{ResultFolder, replace_file};
use opspace_experiment::run::shard::Shard;
use opspace_experiment::run::suite_rows::{SUITE_ROWS, SuiteHeader, SuiteRow, SuiteRows, SuiteRowsFile};
use opspace_experiment::{Experiment, Extensions, Files, RunError, Suite, Summary};
use opspace_log::LogFile;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufWriter};
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

pub fn bench(args: &BenchArgs, extensions: &Extensions, console: Console) -> Outcome {
    let (suite, name) = match &args.suite {
        Some(path) => {
            let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            (Suite::load_with(extensions, Files::Disk, path)?, format!("bench-{stem}"))
        }
        None => (Suite::load(Files::Embedded, Path::new(PAPER_SUITE))?, "bench".to_owned()),
    };
    let suite = suite.on_plants(&open_plants(&args.plants)?)?;
    let shard = args.shard.map(ShardChoice::resolve).transpose()?;
    let header = SuiteHeader::new(&suite, &name, shard);
    let baseline = args.results.check()?;
    let keys: Vec<RunKey> =
        header.numbers().map(|number| RunKey::of_experiment(&suite.experiments[number - 1])).collect();
    if baseline.as_ref().is_some_and(|baseline| !keys.is_empty() && !baseline.has_any(&keys)) {
        return Err(args.results.refuse_foreign());
    }
    let mut logs = log_names(&suite.experiments);
    logs.retain(|&number, _| shard.is_none_or(|shard| shard.contains(number)));
    let folder = folder_of(args.results.output.out.as_deref(), &name, shard);
    let files: Vec<String> =
        logs.values().cloned().chain([REPORT, ROWS, SUITE_ROWS].map(str::to_owned)).collect();
    let mut inputs: Vec<PathBuf> = suite.experiments.iter().flat_map(Experiment::input_paths).collect();
    inputs.push(suite.source.name().into());
    let mut outputs: Vec<PathBuf> = files.iter().map(|name| folder.join(name)).collect();
    outputs.extend(args.results.outputs());
    check_outputs(&inputs, &outputs)?;
    check_outputs(args.results.baseline.as_slice(), &args.results.overwritten(&files))?;

    let watch = interrupt::watch();
    let locked = lock(&folder, shard.is_some(), &watch, console)?;
    let (locked, mut rows) = match continued(&locked, &header, &logs, args.results.output.force) {
        Some(rows) => (locked, rows),
        None => {
            let chosen = args.results.output.out.is_some();
            let folder = empty(locked, chosen, args.results.output.force, &files, console)?;
            (folder, SuiteRows::new(header))
        }
    };
    let folder = locked.path();
    let pending: Vec<usize> =
        rows.header.numbers().filter(|number| !rows.rows.contains_key(number)).collect();
    let mut interrupted = BTreeMap::new();
    let file = rows.append_to(folder).map_err(|e| Failure::io("cannot be written", folder, &e))?;
    if !pending.is_empty() {
        let jobs = args
            .jobs
            .map_or_else(|| std::thread::available_parallelism().map_or(1, NonZero::get), usize::from);
        let sweep = Sweep { suite: &suite, logs: &logs, folder, watch: &watch, console };
        print_start(&suite, &rows, &pending, jobs, console);
        for row in sweep.run(&pending, jobs, &file)? {
            // A run that was interrupted is repeated when the suite is continued.
            if row.row.interrupted {
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
    let mut all: BTreeMap<usize, Summary> =
        rows.rows.iter().map(|(&number, row)| (number, row.row.clone())).collect();
    all.extend(interrupted);
    let summaries: Vec<Summary> = all.into_values().collect();
    let results = SuiteResults { rows: &rows, summaries: &summaries, partial: false, folder };
    let exit = results.write(&args.results, baseline.as_ref(), extensions, console)?;
    let missing = rows.header.numbers().count() - rows.rows.len();
    if missing > 0 {
        console.note(&format!(
            "interrupted: {missing} of {} runs are missing; the same command continues",
            rows.header.numbers().count()
        ));
        return Ok(if exit == Exit::Failed { exit } else { Exit::Interrupted });
    }
    Ok(exit)
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

/// Prints the number of runs and their simulated time.
fn print_start(suite: &Suite, rows: &SuiteRows, pending: &[usize], jobs: usize, console: Console) {
    let simulated_s: f64 = pending.iter().map(|number| suite.experiments[number - 1].duration_s()).sum();
    let mut text = format!("{} runs, {} of simulated time", pending.len(), duration(simulated_s));
    if jobs.min(pending.len()) > 1 {
        text += &format!(", {} at a time", jobs.min(pending.len()));
    }
    if let Some(shard) = rows.header.shard {
        text += &format!("; shard {shard} of {} runs", rows.header.runs);
    }
    if !rows.rows.is_empty() {
        text += &format!("; continued: {} runs are complete", rows.rows.len());
    }
    console.note(&text);
}

/// Formats a duration for a reader: `40 s`, `12 min`, `3.5 h`.
fn duration(s: f64) -> String {
    match s {
        s if s < 9.95 => format!("{s:.1} s"),
        s if s < 119.5 => format!("{s:.0} s"),
        s if s < 119.5 * 60.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// Runs of a suite, and what they share.
struct Sweep<'a> {
    suite: &'a Suite,
    /// File names of the logs that are kept, by the number of the run.
    logs: &'a BTreeMap<usize, String>,
    folder: &'a Path,
    watch: &'a Progress,
    console: Console,
}

impl Sweep<'_> {
    /// Executes runs in parallel, each on one thread, and appends each to the rows when it is complete.
    fn run(&self, pending: &[usize], jobs: usize, file: &SuiteRowsFile) -> Result<Vec<SuiteRow>, Failure> {
        let bar = if self.console.shows_progress() {
            ProgressBar::new(pending.len() as u64)
        } else {
            ProgressBar::hidden()
        };
        bar.set_style(style("{pos:>4}/{len} {wide_bar} {elapsed} {msg}"));
        let jobs = jobs.min(pending.len());
        let next = AtomicUsize::new(0);
        let results: Vec<Mutex<Option<Result<SuiteRow, Failure>>>> =
            pending.iter().map(|_| Mutex::new(None)).collect();
        let estimate = Mutex::new(Estimate::new(self.suite, pending, jobs));
        std::thread::scope(|scope| {
            for _ in 0..jobs {
                scope.spawn(|| {
                    while !self.watch.interrupt.load(Ordering::Relaxed) {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some(&number) = pending.get(index) else { return };
                        let experiment = &self.suite.experiments[number - 1];
                        let result = self.run_one(number, experiment, file);
                        if let Ok(mut slot) = results[index].lock() {
                            *slot = Some(result);
                        }
                        bar.inc(1);
                        let rest = estimate.lock().ok().and_then(|mut e| e.add(experiment.duration_s()));
                        if let Some(rest) = rest {
                            let text = format!("about {} remaining", duration(rest.s));
                            bar.set_message(format!("{}, {text}", experiment.task().name()));
                            if rest.is_first && bar.is_hidden() {
                                self.console.note(&text);
                            }
                        }
                    }
                });
            }
        });
        bar.finish_and_clear();
        // An empty slot belongs to a run that did not start because of an interrupt.
        let done = results.into_iter().filter_map(|slot| slot.into_inner().unwrap_or_default());
        done.collect()
    }

    fn run_one(
        &self,
        number: usize,
        experiment: &Experiment,
        file: &SuiteRowsFile,
    ) -> Result<SuiteRow, Failure> {
        let name = self.logs.get(&number);
        let summary = match name {
            Some(name) => self.run_with_log(&self.folder.join(name), experiment)?,
            None => experiment.run_without_log(self.watch)?,
        };
        let row = SuiteRow::new(number, name.cloned(), summary);
        if row.row.interrupted {
            return Ok(row);
        }
        // The log is there before the row that names it.
        let path = self.folder.join(SUITE_ROWS);
        file.push(&row).map_err(|e| Failure::io("cannot be written", &path, &e))?;
        Ok(row)
    }

    /// Runs an experiment with a log, which is kept if the run was not interrupted.
    fn run_with_log(&self, path: &Path, experiment: &Experiment) -> Result<Summary, Failure> {
        let mut result = None;
        let written = replace_file(path, |file| {
            let (writer, reader) = (file.try_clone()?, file.try_clone()?);
            let summary = experiment.run(BufWriter::new(writer), self.watch).and_then(|finished| {
                let log = LogFile::from_file(reader, path)?;
                experiment.summary_of_file(&log, &finished.record, Some(finished.realtime_factor))
            });
            let is_kept = summary.as_ref().is_ok_and(|summary| !summary.interrupted);
            result = Some(summary);
            if is_kept { Ok(()) } else { Err(io::ErrorKind::Interrupted.into()) }
        });
        match (result, written) {
            (Some(Err(error)), _) => Err(error.into()),
            (Some(Ok(summary)), Ok(())) => Ok(summary),
            (Some(Ok(summary)), Err(_)) if summary.interrupted => Ok(summary),
            (_, Err(error)) => Err(Failure::io("cannot be written", path, &error)),
            (None, Ok(())) => Err(Failure::io("cannot be written", path, &io::ErrorKind::Other.into())),
        }
    }
}

/// Expected duration of the remaining runs, from the simulated time of those that are complete.
struct Estimate {
    began: Instant,
    /// Number of runs until the first estimate: each thread has completed one.
    needed: usize,
    done: usize,
    runs: usize,
    done_s: f64,
    total_s: f64,
}

/// Estimate after a run.
struct Remaining {
    s: f64,
    is_first: bool,
}

impl Estimate {
    fn new(suite: &Suite, pending: &[usize], jobs: usize) -> Self {
        let total_s = pending.iter().map(|number| suite.experiments[number - 1].duration_s()).sum();
        Self { began: Instant::now(), needed: jobs, done: 0, runs: pending.len(), done_s: 0.0, total_s }
    }

    /// Counts a run of `simulated_s`; returns the estimate if there is one and runs remain.
    fn add(&mut self, simulated_s: f64) -> Option<Remaining> {
        self.done += 1;
        self.done_s += simulated_s;
        if self.done < self.needed || self.done == self.runs {
            return None;
        }
        let rate = self.done_s / self.began.elapsed().as_secs_f64();
        Some(Remaining { s: (self.total_s - self.done_s) / rate, is_first: self.done == self.needed })
    }
}

/// File names of the logs that are kept, by the number of the run: the first run of each task on each plant, which is
/// drawn too.
fn log_names(experiments: &[Experiment]) -> BTreeMap<usize, String> {
    let (mut tasks, mut names, mut logs) = (BTreeSet::new(), BTreeSet::new(), BTreeMap::new());
    for (number, experiment) in (1..).zip(experiments) {
        let plant = experiment.plant();
        if !tasks.insert((experiment.task().source.name(), plant.clone())) {
            continue;
        }
        let mut name = format!("{}-{}", experiment.task().name(), experiment.options().backend.name());
        if plant != OWN_PLANT {
            name += &format!("-{}", plant.replace(' ', "-"));
        }
        // Two tasks of a suite may have one name.
        let free = (1..).map(|k| if k == 1 { format!("{name}.mcap") } else { format!("{name}-{k}.mcap") });
        logs.extend(free.into_iter().find(|name| names.insert(name.clone())).map(|name| (number, name)));
    }
    logs
}
