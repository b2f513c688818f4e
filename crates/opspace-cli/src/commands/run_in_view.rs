//! `opspace run --view`: a run that a browser shows while it takes place.

use crate::cli::RunArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::result_folder::empty;
use crate::view_address::{Side, ViewAddress};
use opspace_control::TaskParameters;
use opspace_experiment::run::result_files::ResultFolder;
use opspace_experiment::{
    Companion, CompanionEntry, Extensions, FileError, Files, Progress, RunError, RunSummary, Scenario,
};
use opspace_live::{LiveRun, LiveView, ViewKind};
use opspace_report::{LeftBehind, run_arms_in_folder, run_on_drivers_with};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Time without a page after which a view of a finished run ends.
const ALONE: Duration = Duration::from_secs(3);

/// Begins to serve a view at an address, also to pages of these other origins, and prints where it is.
pub fn open_view(
    (address, origins): (ViewAddress, &[String]),
    title: &str,
    kind: ViewKind,
    console: Console,
) -> Result<LiveView, Failure> {
    let ViewAddress { socket, any_port } = address;
    let another =
        || any_port.then(|| LiveView::start_for(SocketAddr::new(socket.ip(), 0), origins, title, kind));
    let view =
        LiveView::start_for(socket, origins, title, kind).or_else(|error| another().unwrap_or(Err(error)));
    let view = view.map_err(|error| {
        Failure::Other(format!("{socket}: the view cannot be served there: {error}"), Exit::Bad)
    })?;
    console.tell(&format!("view at {}", view.address().page()));
    Ok(view)
}

/// Returns the scenario of one simulated robot with gains and modes of its Cartesian tasks as inputs, which a page changes, and the
/// settings for it, which its log has. A task that cannot be loaded so stays as it is.
pub fn with_tunable_tasks(
    scenario: Scenario,
    set: &[String],
    load: impl Fn(&[String]) -> Result<Scenario, FileError>,
) -> (Scenario, Vec<String>) {
    let tasks = scenario.single().map(|experiment| experiment.task().file.task.iter());
    let tunable = tasks.into_iter().flatten().filter_map(|(name, task)| match task {
        TaskParameters::Cartesian(task) if !task.tunable => {
            Some(format!("task.{name}.cartesian.tunable=true"))
        }
        _ => None,
    });
    let with_all: Vec<String> = set.iter().cloned().chain(tunable).collect();
    match load(&with_all) {
        Ok(tunable) => (tunable, with_all),
        Err(_) => (scenario, set.to_vec()),
    }
}

/// Adds the robots of `--beside` to the scenario of a task; `set` are its settings.
pub fn with_robots_beside(
    scenario: Scenario,
    args: &RunArgs,
    set: &[String],
    extensions: &Extensions,
) -> Result<Scenario, Failure> {
    let Some(own) = scenario.single().filter(|_| !args.beside.is_empty()) else {
        if args.beside.is_empty() {
            return Ok(scenario);
        }
        let text = "--beside is for a task of one robot: an experiment states its robots itself";
        return Err(Failure::Other(text.to_owned(), Exit::Bad));
    };
    let first = Side { backend: own.options().backend, controller: own.options().controller };
    let mut robots = vec![(first.name().to_owned(), own.clone())];
    for side in &args.beside {
        let options = opspace_experiment::RunOptions { controller: side.controller, ..args.options() };
        let (robot, backend) = (args.robot.as_deref(), Some(side.backend));
        let beside = Scenario::load(extensions, Files::Disk, &args.task, robot, backend, options, set)?;
        if robots.iter().any(|(name, _)| name == side.name()) {
            let text = format!("--beside {}: this robot is in the view already", side.name());
            return Err(Failure::Other(text, Exit::Bad));
        }
        robots.extend(beside.single().map(|experiment| (side.name().to_owned(), experiment.clone())));
    }
    Ok(Scenario::beside(robots)?)
}

/// Runs a scenario on its real robots, with the companions that the program adds, and shows it if there is a view, which only
/// watches.
pub fn run_with_companions(
    live: Option<&LiveView>,
    scenario: &Scenario,
    extensions: &Extensions,
    results: &ResultFolder,
    progress: &Progress,
    left_behind: LeftBehind<'_>,
) -> Result<RunSummary, RunError> {
    let mut companions: Vec<Box<dyn Companion + '_>> = Vec::new();
    if let Some(live) = live {
        companions.push(Box::new(LiveRun::new(live, scenario, None, Arc::clone(&progress.interrupt))));
    }
    for entry in extensions.all::<CompanionEntry>() {
        if let Some(companion) = entry.open(scenario, progress)? {
            companions.push(companion);
        }
    }
    let summary =
        run_on_drivers_with(scenario, extensions, results, progress, (&mut companions, left_behind))?;
    if let Some(live) = live {
        live.end(&outcome(&summary));
    }
    Ok(summary)
}

/// Simulates a scenario and shows it, until the user ends the view; again if the page asks for it. `say` shows the results of each
/// run, and returns their exit code.
pub fn simulate_in_view(
    live: &LiveView,
    results: ResultFolder,
    files: &[String],
    (scenario, progress, console): (&Scenario, &Progress, Console),
    say: &dyn Fn(&RunSummary, &Path) -> Outcome,
) -> Outcome {
    let mut results = results;
    loop {
        let mut arms = scenario.pushable_arms()?;
        let mut companion = LiveRun::new(live, scenario, Some(&arms), Arc::clone(&progress.interrupt));
        let summary = run_arms_in_folder(scenario, &mut arms, &results, progress, &mut companion)?;
        live.end(&outcome(&summary));
        let exit = say(&summary, results.path())?;
        say_pace(live, console);
        if !wait_for_restart(live, progress) {
            return Ok(exit);
        }
        // The folder is moved aside, which its lock would prevent.
        let path = results.path().to_owned();
        drop(results);
        results = empty(ResultFolder::open(&path)?, false, false, files, console)?;
        live.play();
    }
}

/// Waits for a page to ask for a new run; returns false if the user ends the view, or no page is left.
fn wait_for_restart(live: &LiveView, progress: &Progress) -> bool {
    let mut seen = Instant::now();
    while !live.wants_restart() {
        if live.pages() > 0 {
            seen = Instant::now();
        }
        if progress.interrupt.load(Ordering::Relaxed) || seen.elapsed() > ALONE {
            return false;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    true
}

/// Prints how well the run kept its pace, and what pages have missed.
fn say_pace(live: &LiveView, console: Console) {
    console.note(&format!(
        "view: {} cycles began late, {} messages were dropped for slow pages",
        live.late_cycles(),
        live.dropped()
    ));
}

/// Describes the outcome of a run for the page.
pub fn outcome(summary: &RunSummary) -> String {
    let robots = summary.robots.values();
    let fault = robots.clone().find_map(|robot| robot.faulted.clone());
    let interrupted = robots.clone().any(|robot| robot.interrupted);
    fault.unwrap_or_else(|| (if interrupted { "interrupted" } else { "completed" }).to_owned())
}
