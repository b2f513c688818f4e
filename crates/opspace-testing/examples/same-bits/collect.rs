//! Execution of all runs and checks of a build, several at a time.

use crate::entries::{self, Item};
use crate::shipped::{Kind, Shipped, shipped};
use crate::side::{Log, Side, with_signals};
use crate::suites::Suite;
use std::cmp::Reverse;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Part of the runs of tasks and experiments alone.
const FILES: &str = "files";
/// Part of the checks.
const CHECK: &str = "check";

/// Suites that are executed only if they are named: with the reason.
const LEFT_OUT: [(&str, &str); 1] = [("teleop-matrix", "320 runs of the same kinds as in teleop")];

/// True if a part is compared unless others are named.
#[must_use]
pub fn is_default(part: &str) -> bool {
    LEFT_OUT.iter().all(|(name, _)| *name != part)
}

/// Work of one process of the program.
#[derive(Debug)]
pub struct Unit {
    /// Part of the results.
    pub part: String,
    file: Shipped,
    work: Work,
    /// Number of runs of its file, by which the longest work is begun first.
    size: usize,
}

#[derive(Debug)]
enum Work {
    Suite(Suite),
    Run,
    Check,
}

/// Lists the work of the parts; of all parts without any name.
///
/// # Errors
/// Files that cannot be read, and a part that does not exist.
pub fn units(side: &Side, parts: &[String]) -> Result<Vec<Unit>, String> {
    let mut units = Vec::new();
    for file in shipped(&side.checkout)? {
        let stem = file.name.trim_end_matches(".toml").to_owned();
        let is_chosen = |part: &str| match parts {
            [] => is_default(part),
            _ => parts.iter().any(|chosen| chosen == part),
        };
        let suite = if file.kind == Kind::Suite { Some(side.suite(&file)?) } else { None };
        let size = suite.as_ref().map_or(1, |suite| suite.runs.len());
        let mut add = |part: &str, work| {
            units.push(Unit { part: part.to_owned(), file: file.clone(), work, size });
        };
        if is_chosen(CHECK) {
            add(CHECK, Work::Check);
        }
        match suite {
            Some(suite) if is_chosen(&stem) => add(&stem, Work::Suite(suite)),
            None if file.kind == Kind::Run && is_chosen(FILES) => add(FILES, Work::Run),
            _ => {}
        }
    }
    match parts.iter().find(|part| units.iter().all(|unit| unit.part != **part)) {
        Some(part) => Err(format!("'{part}' is neither a suite nor `{FILES}` nor `{CHECK}`")),
        None => Ok(units),
    }
}

impl Unit {
    /// Executes the work in an empty folder, and lists the results.
    fn execute(&self, side: &Side, jobs: usize, folder: &Path) -> Result<Vec<Item>, String> {
        match &self.work {
            Work::Suite(suite) => {
                let mut items = Vec::new();
                let mut add = |run, logs: Vec<Log>| items.extend(with_signals(run, &logs));
                side.run_suite(&self.file, suite, jobs, folder, &mut add)?;
                Ok(items)
            }
            Work::Run => {
                side.run_file(&self.file, &folder.join("out")).map(|(run, logs)| with_signals(run, &logs))
            }
            Work::Check => Ok(vec![side.check(&self.file)?]),
        }
    }

    /// Executes only the run at a place, in an empty folder; none if it is not in this work.
    ///
    /// # Errors
    /// As the execution of all.
    pub fn run_alone(
        &self,
        side: &Side,
        place: &str,
        folder: &Path,
    ) -> Result<Vec<(Item, Vec<Log>)>, String> {
        match &self.work {
            Work::Suite(suite) => {
                let mut runs = Vec::new();
                side.run_suite(&self.file, &suite.clone().only(place), 1, folder, &mut |run: Item, logs| {
                    if run.place == place {
                        runs.push((run, logs));
                    }
                })?;
                Ok(runs)
            }
            Work::Run if self.file.name == place => Ok(vec![side.run_file(&self.file, &folder.join("out"))?]),
            Work::Run | Work::Check => Ok(Vec::new()),
        }
    }
}

/// Executes the work, and passes the results of each part, when it is complete, to `write`.
///
/// # Errors
/// The first error of any work.
pub fn collect(
    side: &Side,
    units: &[Unit],
    jobs: usize,
    write: &(dyn Fn(&str, &str) -> Result<(), String> + Sync),
) -> Result<(), String> {
    let mut order: Vec<usize> = (0..units.len()).collect();
    order.sort_by_key(|&index| Reverse(units[index].size));
    let begun = Instant::now();
    let (next, done) = (AtomicUsize::new(0), Mutex::new(vec![None; units.len()]));
    let each = || -> Result<(), String> {
        while let Some(&index) = order.get(next.fetch_add(1, Ordering::Relaxed)) {
            let unit = &units[index];
            let folder = tempfile::tempdir().map_err(|e| e.to_string())?;
            let items = unit.execute(side, (jobs / units.len()).max(1), folder.path())?;
            let mut done = done.lock().map_err(|e| e.to_string())?;
            done[index] = Some(entries::text(&items));
            let of_part = units.iter().zip(done.iter()).filter(|(other, _)| other.part == unit.part);
            if let Some(texts) = of_part.map(|(_, text)| text.as_deref()).collect::<Option<Vec<&str>>>() {
                write(&unit.part, &texts.concat())?;
                eprintln!("{} is complete after {:.0} s", unit.part, begun.elapsed().as_secs_f64());
            }
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..jobs.max(1)).map(|_| scope.spawn(each)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().map_err(|_| "a thread failed".to_owned())?)
    })
}
