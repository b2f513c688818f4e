//! Execution of the runs of a suite, several at a time.

use crate::console::{Console, Failure};
use crate::result_folder::clear_run_of_robots;
use crate::run_progress::style;
use indicatif::ProgressBar;
use opspace_experiment::run::physics::OWN_PLANT;
use opspace_experiment::run::result_files::{ResultFolder, replace_file};
use opspace_experiment::{Experiment, Progress, RunSummary, Scenario, Summary};
use opspace_log::LogFile;
use opspace_report::run_in_folder;
use opspace_suite::suite_rows::{SUITE_ROWS, SuiteRow, SuiteRows, SuiteRowsFile};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, BufWriter};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Name of a run's log without the ending, and the ending: none for a folder with the logs of several robots.
fn log_name(run: &Scenario) -> (String, &'static str) {
    match run.single() {
        Some(experiment) => (format!("{}-{}", run.name(), experiment.options().backend.name()), ".mcap"),
        None => (run.name(), ""),
    }
}

/// Executes a run with its log, or with a folder of logs, which is kept if the run was not interrupted.
fn run_with_log(run: &Scenario, path: &Path, watch: &Progress) -> Result<RunSummary, Failure> {
    if let Some(experiment) = run.single() {
        return Ok(run_with_file(experiment, path, watch)?.into());
    }
    // The rest of a run that was cut off.
    clear_run_of_robots(path)?;
    let summary = run_in_folder(run, &ResultFolder::open(path)?, watch)?;
    if summary.is_interrupted() {
        clear_run_of_robots(path)?;
    }
    Ok(summary)
}

fn run_with_file(experiment: &Experiment, path: &Path, watch: &Progress) -> Result<Summary, Failure> {
    let mut result = None;
    let written = replace_file(path, |file| {
        let (writer, reader) = (file.try_clone()?, file.try_clone()?);
        let summary = experiment.run(BufWriter::new(writer), watch).and_then(|finished| {
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

/// Prints the number of runs and their simulated time.
pub fn print_start(runs: &[Scenario], rows: &SuiteRows, pending: &[usize], jobs: usize, console: Console) {
    let simulated_s: f64 = pending.iter().map(|number| runs[number - 1].duration_s()).sum();
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
pub struct Sweep<'a> {
    /// All runs.
    pub runs: &'a [Scenario],
    /// Names of the logs that are kept, by the number of the run.
    pub logs: &'a BTreeMap<usize, String>,
    /// Folder of the results.
    pub folder: &'a Path,
    /// Requests to stop.
    pub watch: &'a Progress,
    /// Receives the progress.
    pub console: Console,
}

impl Sweep<'_> {
    /// Executes runs in parallel, each on one thread, and appends each to the rows when it is complete.
    pub fn run(
        &self,
        pending: &[usize],
        jobs: usize,
        file: &SuiteRowsFile,
    ) -> Result<Vec<SuiteRow>, Failure> {
        let bar = if self.console.shows_progress() {
            ProgressBar::new(pending.len() as u64)
        } else {
            ProgressBar::hidden()
        };
        bar.set_style(style("{pos:>4}/{len} {wide_bar} {elapsed} {msg}"));
        let jobs = jobs.min(pending.len());
        let next = AtomicUsize::new(0);
        type Slot = Mutex<Option<Result<SuiteRow, Failure>>>;
        let results: Vec<Slot> = pending.iter().map(|_| Mutex::new(None)).collect();
        let estimate = Mutex::new(Estimate::new(self.runs, pending, jobs));
        std::thread::scope(|scope| {
            for _ in 0..jobs {
                scope.spawn(|| {
                    while !self.watch.interrupt.load(Ordering::Relaxed) {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        let Some(&number) = pending.get(index) else { return };
                        let run = &self.runs[number - 1];
                        let result = self.run_one(number, run, file);
                        if let Ok(mut slot) = results[index].lock() {
                            *slot = Some(result);
                        }
                        bar.inc(1);
                        let rest = estimate.lock().ok().and_then(|mut e| e.add(run.duration_s()));
                        if let Some(rest) = rest {
                            let text = format!("about {} remaining", duration(rest.s));
                            bar.set_message(format!("{}, {text}", run.name()));
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

    fn run_one(&self, number: usize, run: &Scenario, file: &SuiteRowsFile) -> Result<SuiteRow, Failure> {
        let name = self.logs.get(&number);
        let summary = match name {
            Some(name) => run_with_log(run, &self.folder.join(name), self.watch)?,
            None => run.run_without_logs(self.watch)?,
        };
        let row = SuiteRow::new(number, name.cloned(), summary);
        if row.row.is_interrupted() {
            return Ok(row);
        }
        // The log is there before the row that names it.
        let path = self.folder.join(SUITE_ROWS);
        file.push(&row).map_err(|e| Failure::io("cannot be written", &path, &e))?;
        Ok(row)
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
    fn new(all: &[Scenario], pending: &[usize], jobs: usize) -> Self {
        let total_s = pending.iter().map(|number| all[number - 1].duration_s()).sum();
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

/// Names of the logs that are kept, by the number of the run: the first run of each task or experiment on each plant, which
/// is drawn too.
pub fn log_names(runs: &[Scenario]) -> BTreeMap<usize, String> {
    let (mut files, mut names, mut logs) = (BTreeSet::new(), BTreeSet::new(), BTreeMap::new());
    for (number, run) in (1..).zip(runs) {
        let plant = run.plant();
        if !files.insert((run.source.name().to_owned(), plant.clone())) {
            continue;
        }
        let (mut name, end) = log_name(run);
        if plant != OWN_PLANT {
            name += &format!("-{}", plant.replace(' ', "-"));
        }
        // Two tasks of a suite may have one name.
        let free = (1..).map(|k| if k == 1 { format!("{name}{end}") } else { format!("{name}-{k}{end}") });
        logs.extend(free.into_iter().find(|name| names.insert(name.clone())).map(|name| (number, name)));
    }
    logs
}
