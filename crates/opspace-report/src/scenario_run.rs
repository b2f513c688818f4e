//! Execution of a scenario: a log, a summary and a page for each robot, and with several robots for all.

use crate::coupling_figures::coupling_figures;
use crate::coupling_pages::coupling_page;
use crate::document::{RunSection, page};
use crate::figure::Figure;
use crate::folder::{
    NewLog, finish_folder, finish_left_behind as finish_log_left_behind, save, save_summary,
};
use opspace_backend::{Backend, Capabilities};
use opspace_experiment::evaluate::run_summary::{CouplingsEvaluator, RunSummary};
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::extensions::Extensions;
use opspace_experiment::files::source::FileError;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::run::companion::Companion;
use opspace_experiment::run::error::RunError;
use opspace_experiment::run::execute::{LogCloser, Progress};
use opspace_experiment::run::result_files::{LOG, REPORT, ResultFolder};
use opspace_experiment::run::robot_watch::RobotWatch;
use opspace_experiment::run::scenario::Scenario;
use opspace_log::{LogError, LogFile, OutcomeRecord, ViewerReceiver};
use opspace_sim::SimulatedArm;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::Builder;

/// Function that gets the results of a run whose real robots cannot be reached: a call of a driver does not return, so that
/// the run's own thread is blocked. It is called in another thread, with the log closed, and must end the program.
pub type LeftBehind<'a> = &'a (dyn Fn(Result<RunSummary, RunError>) + Sync);

/// Name of the thread that watches real robots.
const WATCH: &str = "opspace-watch";

/// Function of all robots, in the order of the scenario, while they are open.
type Body<'a, T> = dyn FnMut(&mut [&mut dyn Backend]) -> Result<T, RunError> + 'a;

/// Runs the scenario in simulation in a folder that the caller has locked, with log, summary and page of the robot. Several
/// robots have these files in a folder of the name of each, and a summary and a page of all. Existing logs are never
/// overwritten.
///
/// # Errors
/// A robot that cannot be simulated; a folder that already holds a log; files that cannot be written.
pub fn run_in_folder(
    scenario: &Scenario,
    folder: &ResultFolder,
    progress: &Progress,
) -> Result<RunSummary, RunError> {
    run_arms_in_folder(scenario, &mut scenario.simulated_arms()?, folder, progress, &mut ())
}

/// Runs the scenario in a folder as [`run_in_folder`] does, on simulated arms of the caller, in its order, and with a companion.
///
/// # Errors
/// As [`run_in_folder`].
pub fn run_arms_in_folder(
    scenario: &Scenario,
    arms: &mut [SimulatedArm],
    folder: &ResultFolder,
    progress: &Progress,
    companion: &mut dyn Companion,
) -> Result<RunSummary, RunError> {
    let mut robots: Vec<&mut dyn Backend> = arms.iter_mut().map(|arm| arm as &mut dyn Backend).collect();
    // Simulated robots are not watched.
    run_robots(scenario, &mut robots, folder, progress, (companion, &|_| {}))
}

/// Runs the scenario in a folder as [`run_in_folder`] does, with the real robots opened by drivers in
/// `extensions`, and the others simulated. All robots are read in one thread, each when its next cycle begins: a robot whose
/// clock differs from those of the others misses a cycle now and then. A simulated robot waits for the real ones.
///
/// Another thread watches the real robots. If no cycle is completed for longer than `max_dropout_s`, or for 0.1 s after a stop
/// was requested, it calls [`Backend::remote_stop`]. If the call does not return even so, it calls `left_behind`.
///
/// # Errors
/// As [`run_in_folder`]; a driver that is unknown or cannot open its robot, a real robot that is not at
/// its start position, or objects, which only a simulation has.
pub fn run_on_drivers(
    scenario: &Scenario,
    extensions: &Extensions,
    folder: &ResultFolder,
    progress: &Progress,
    left_behind: LeftBehind<'_>,
) -> Result<RunSummary, RunError> {
    run_on_drivers_with(scenario, extensions, folder, progress, (&mut (), left_behind))
}

/// Runs the scenario as [`run_on_drivers`] does, with a companion beside the function for robots that cannot be reached.
///
/// # Errors
/// As [`run_on_drivers`].
pub fn run_on_drivers_with(
    scenario: &Scenario,
    extensions: &Extensions,
    folder: &ResultFolder,
    progress: &Progress,
    (companion, left_behind): (&mut dyn Companion, LeftBehind<'_>),
) -> Result<RunSummary, RunError> {
    if let (Some(robot), Some(object)) = (scenario.real_robots().first(), scenario.objects.keys().next()) {
        let message =
            format!("objects are simulated, but robot '{robot}' is real: its robot.toml has a [driver]");
        let help = Some("remove the object, or add --simulate".to_owned());
        return Err(FileError::at_key(&scenario.source, ["objects", object], message, help).into());
    }
    with_robots(scenario, extensions, Vec::new(), &mut |robots| {
        run_robots(scenario, robots, folder, progress, (&mut *companion, left_behind))
    })
}

/// Opens the robots that follow those that are `open`, and calls `body` with all.
fn with_robots<T>(
    scenario: &Scenario,
    extensions: &Extensions,
    open: Vec<&mut dyn Backend>,
    body: &mut Body<'_, T>,
) -> Result<T, RunError> {
    let mut open = open;
    let Some(member) = scenario.members.get(open.len()) else { return body(&mut open) };
    if !member.experiment.has_driver() {
        let mut arm = member.experiment.simulated_arm()?;
        return with_robots(scenario, extensions, with(open, &mut arm), body);
    }
    member.experiment.with_driver(extensions, |robot| {
        member.experiment.check_robot(robot)?;
        with_robots(scenario, extensions, with(open, robot), body)
    })
}

/// Runs the scenario on these robots, in their order, as [`run_in_folder`] does.
pub(crate) fn run_robots(
    scenario: &Scenario,
    robots: &mut [&mut dyn Backend],
    folder: &ResultFolder,
    progress: &Progress,
    (companion, left_behind): (&mut dyn Companion, LeftBehind<'_>),
) -> Result<RunSummary, RunError> {
    // A single robot has no folder of its own.
    let members = scenario.members.iter().filter(|_| scenario.single().is_none());
    let inner = members.map(|member| ResultFolder::open(&folder.path().join(&member.name)));
    let inner = inner.collect::<Result<Vec<_>, _>>()?;
    let folders: Vec<&ResultFolder> = if inner.is_empty() { vec![folder] } else { inner.iter().collect() };
    let (mut logs, mut files) = (Vec::new(), Vec::new());
    let created = folders.iter().try_for_each(|folder| {
        let (log, file) = NewLog::create(folder)?;
        logs.push(log);
        files.push(file);
        Ok(())
    });
    let closers = Mutex::new(Vec::new());
    // The robots are opened in their order.
    let mut files = files.into_iter();
    let open =
        |number: usize, capabilities: &Capabilities, truth, receivers: Vec<Box<dyn ViewerReceiver>>| {
            let file = files.next().ok_or_else(|| RunError::Incomplete { what: "a log".to_owned() })?;
            let experiment = &scenario.members[number].experiment;
            let (control, log) = experiment.open_with(capabilities, truth, file, progress, receivers)?;
            lock(&closers).push(log.closer());
            Ok((control, log))
        };
    let give_up = |silent_s: f64| {
        let closed = close_left_behind(scenario, silent_s, progress, &lock(&closers));
        left_behind(closed.and_then(|record| finish_left_behind(scenario, folder, &folders, &logs, &record)));
    };
    let watch = RobotWatch::new(scenario, robots, progress);
    let driven = created.and_then(|()| {
        watched(watch, give_up, || scenario.drive_robots_with(robots, progress, companion, open))
    });
    let driven = driven.inspect_err(|_| logs.iter().for_each(NewLog::discard))?;
    let mut summaries = Vec::new();
    for (((experiment, own), log), (sink, outcome)) in
        scenario.experiments().zip(&folders).zip(logs).zip(driven)
    {
        summaries.push(finish_folder(experiment, own, log, sink.close(experiment, outcome))?);
    }
    finish(scenario, folder, summaries)
}

/// Closes the logs of robots that cannot be reached. Returns the outcome.
fn close_left_behind<W>(
    scenario: &Scenario,
    silent_s: f64,
    progress: &Progress,
    logs: &[LogCloser<W>],
) -> Result<OutcomeRecord, RunError> {
    let rate_hz: f64 = scenario.experiments().map(|experiment| 1.0 / experiment.profile().1.period_s()).sum();
    let rest_s = scenario.experiments().map(|experiment| experiment.robot().file.safety.tare_s.get());
    let passed_s = progress.ticks.load(Ordering::Relaxed) as f64 / rate_hz;
    let fault = format!(
        "the robot could not be reached: a call of its driver has not returned for {silent_s:.1} s; \
         the robot may still follow its last command"
    );
    let record = OutcomeRecord {
        fault: Some(fault),
        time_s: Some(passed_s - rest_s.fold(0.0, f64::max)),
        ..OutcomeRecord::default()
    };
    let record = logs.first().map_or_else(|| record.clone(), |log| log.with_scheduling(record.clone()));
    logs.iter().try_for_each(|log| log.abandon(record.clone()))?;
    Ok(record)
}

/// Writes the summaries and pages of robots that cannot be reached.
fn finish_left_behind(
    scenario: &Scenario,
    folder: &ResultFolder,
    folders: &[&ResultFolder],
    logs: &[NewLog],
    record: &OutcomeRecord,
) -> Result<RunSummary, RunError> {
    let each = scenario.experiments().zip(folders).zip(logs);
    let summaries =
        each.map(|((experiment, own), log)| finish_log_left_behind(experiment, own, log.again()?, record));
    finish(scenario, folder, summaries.collect::<Result<_, _>>()?)
}

/// Summary of all robots; with several, it and the page are written.
fn finish(scenario: &Scenario, folder: &ResultFolder, robots: Vec<Summary>) -> Result<RunSummary, RunError> {
    match scenario.single() {
        Some(_) => Ok(CouplingsEvaluator::new(scenario).finish(robots)),
        None if scenario.couplings.is_empty() && scenario.objects.is_empty() => {
            write_comparison(scenario, folder.path(), robots)
        }
        None => write_pages(scenario, folder.path(), robots),
    }
}

/// Computes the summary of a run of several robots and the page about it from the logs and the summaries of the robots, in
/// the order of `members`.
///
/// # Errors
/// A log that cannot be read.
pub fn summary_and_page(
    scenario: &Scenario,
    logs: &[LogFile],
    robots: Vec<Summary>,
) -> Result<(RunSummary, String), RunError> {
    let mut evaluator = CouplingsEvaluator::new(scenario);
    let mut sections = Vec::new();
    for (number, ((member, log), robot)) in scenario.members.iter().zip(logs).zip(&robots).enumerate() {
        log.for_each_segment(&mut |segment, is_last| evaluator.add(number, segment, is_last))?;
        sections.push((member.name.clone(), RunSection::of_file(&member.experiment, log, robot.clone())?));
    }
    let figures: Vec<Figure> = evaluator.couplings.iter().flat_map(coupling_figures).collect();
    let summary = evaluator.finish(robots);
    let page = coupling_page(scenario, &summary, &figures, &sections);
    Ok((summary, page))
}

/// Writes summary and page of all robots.
fn write_pages(scenario: &Scenario, folder: &Path, robots: Vec<Summary>) -> Result<RunSummary, RunError> {
    let logs = scenario.members.iter().map(|member| LogFile::open(folder.join(&member.name).join(LOG)));
    let (mut summary, html) = summary_and_page(scenario, &logs.collect::<Result<Vec<_>, _>>()?, robots)?;
    summary.not_saved.extend(save(folder, REPORT, &html));
    summary.not_saved.extend(save_summary(folder, &summary)?);
    Ok(summary)
}

/// Writes the page about robots that ran side by side.
fn write_comparison(
    scenario: &Scenario,
    folder: &Path,
    robots: Vec<Summary>,
) -> Result<RunSummary, RunError> {
    let mut sections = Vec::new();
    for (member, robot) in scenario.members.iter().zip(&robots) {
        let log = LogFile::open(folder.join(&member.name).join(LOG))?;
        sections.push(RunSection::of_file(&member.experiment, &log, robot.clone())?);
    }
    let added =
        scenario.experiments().next().map(|experiment| default_columns(experiment.task().tables.added()));
    let lead = "The same task on several robots, under the same external forces.";
    let html = page(&scenario.name(), lead, &robots, &added.unwrap_or_default(), &sections);
    let mut summary = CouplingsEvaluator::new(scenario).finish(robots);
    summary.not_saved.extend(save(folder, REPORT, &html));
    summary.not_saved.extend(save_summary(folder, &summary)?);
    Ok(summary)
}

/// Calls `body` while another thread watches the robots; if they cannot be reached, it calls `give_up` with the time without a
/// cycle, s.
fn watched<T>(
    watch: Option<RobotWatch<'_>>,
    give_up: impl FnOnce(f64) + Send,
    body: impl FnOnce() -> Result<T, RunError>,
) -> Result<T, RunError> {
    let Some(watch) = watch else { return body() };
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watching = || {
            if let Some(silent_s) = watch.watch(&done) {
                give_up(silent_s);
            }
        };
        let watching = Builder::new().name(WATCH.to_owned()).spawn_scoped(scope, watching);
        let watching = watching.map_err(LogError::Write)?;
        let result = catch_unwind(AssertUnwindSafe(body));
        done.store(true, Ordering::Release);
        watching.thread().unpark();
        result.unwrap_or_else(|panic| resume_unwind(panic))
    })
}

/// Locks a value, whatever became of another thread.
fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the robots with one more, which may be borrowed for a shorter time.
fn with<'a, 'b: 'a>(robots: Vec<&'b mut dyn Backend>, one: &'a mut dyn Backend) -> Vec<&'a mut dyn Backend> {
    robots.into_iter().map(|robot| robot as &mut dyn Backend).chain([one]).collect()
}
