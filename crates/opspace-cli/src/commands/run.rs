//! `opspace run`: executes a task on one robot, or an experiment with several.

use crate::cli::{BackendChoice, RunArgs};
use crate::commands::check::large_log;
use crate::commands::run_in_view::{
    open_view, run_with_companions, simulate_in_view, with_robots_beside, with_tunable_tasks,
};
use crate::commands::run_on_log::{run_on_log, say_fault, say_written};
use crate::console::{
    Console, Exit, Failure, Outcome, failures_and_folder, note, owner_result, render, report,
    results as table,
};
use crate::interrupt;
use crate::output::pretty;
use crate::plant::PlantChoice;
use crate::result_folder::{MOVE_TO_START, prepare};
use crate::run_progress::{exit_code, exit_code_of_robot, with_bar};
use opspace_experiment::evaluate::headline::headline;
use opspace_experiment::evaluate::notes::final_notes;
use opspace_experiment::files::origin::Kind;
use opspace_experiment::files::robot::RobotDefinition;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::run::result_files::{LOG, REPORT, SUMMARY};
use opspace_experiment::{
    ControllerKind, Experiment, Extensions, FileError, Files, Metric, Progress, RunError, RunSummary,
    Scenario, Summary,
};
use opspace_live::ViewKind;
use opspace_preflight::{checked_for_real_robots, coupling_diagnostics, loop_margin, problems};
use opspace_report::coupling_table::coupling_table;
use opspace_report::run_in_folder;
use std::path::{Path, PathBuf};

pub fn run(args: &RunArgs, extensions: &Extensions, console: Console) -> Outcome {
    if Files::Disk.kind(&args.task) == Some(Kind::Experiment) {
        refuse_options_of_one_robot(args)?;
    }
    let backend = match args.backend {
        Some(BackendChoice::Replay) => return run_on_log(args, extensions, console),
        Some(BackendChoice::Interface(kind)) => Some(kind),
        None => None,
    };
    if args.log.is_some() {
        let text = "--log is for --backend replay".to_owned();
        return Err(Failure::Other(text, Exit::Bad));
    }
    let (robot, options) = (args.robot.as_deref(), args.options());
    let load = |set: &[String]| {
        Scenario::load(extensions, Files::Disk, &args.task, robot, backend, options.clone(), set)
    };
    let scenario = load(&args.set)?;
    let is_simulated = scenario.real_robots().is_empty() || args.simulate;
    let (scenario, set) = match args.view.view {
        Some(_) if is_simulated => with_tunable_tasks(scenario, &args.set, load),
        _ => (scenario, args.set.clone()),
    };
    let scenario = with_robots_beside(scenario, args, &set, extensions)?;
    let real = scenario.real_robots().first().map(|name| (*name).to_owned()).filter(|_| !args.simulate);
    if let (Some(name), true) = (&real, !args.plant.is_own()) {
        let robot = scenario.single().map_or_else(|| format!("robot '{name}'"), |_| "this robot".to_owned());
        let text = format!("{robot} is real, as its [driver] says: add --simulate to choose a plant");
        return Err(Failure::Other(text, Exit::Bad));
    }
    let scenario = match args.plant.open(extensions)? {
        None => scenario,
        Some(engine) => scenario.on_engine(&engine)?,
    };
    scenario.single().into_iter().for_each(|experiment| say_details(experiment, console));
    let scenario = if real.is_some() { checked_for_real_robots(scenario)? } else { scenario };
    scenario.allowed().iter().for_each(|refusal| console.note(&format!("warning: {refusal}")));
    if real.is_some() {
        note_doubts_of_drivers(&scenario, extensions, console)?;
    }
    note_problems(&scenario, args, extensions, console);
    let default = default_folder(&scenario, &args.plant);
    let results = prepare(&args.output, &default, &file_names(&scenario), &scenario.input_paths(), console)?;
    let folder = results.path();
    let progress = if real.is_some() { interrupt::watch_with_robots() } else { interrupt::watch() };
    scenario.experiments().filter_map(large_log).for_each(|text| console.note(&text));
    console.note(&start_text(&scenario, args)?);
    if real.is_some() {
        for experiment in scenario.experiments().filter(|experiment| experiment.has_driver()) {
            note_missing_real_time(experiment.robot(), console)?;
            note_delay(experiment, console);
        }
    }
    let columns = default_columns(extensions.added());
    let of_real_robot = scenario.single().filter(|_| real.is_some());
    let state = of_real_robot.and_then(|experiment| experiment.state_after_run(extensions));
    let view = RunView {
        scenario: &scenario,
        args,
        columns: &columns,
        progress: &progress,
        state_after_run: state.as_deref(),
        console,
    };
    if let Some(experiment) = scenario.single().filter(|_| args.move_to_start)
        && let Some(exit) = move_to_start(experiment, extensions, folder, view)?
    {
        return Ok(exit);
    }
    let live = args.view.view.map(|address| {
        open_view((address, &args.view.view_origin), &scenario.name(), ViewKind::Run, console)
    });
    let live = live.transpose()?;
    if let Some(live) = live.as_ref().filter(|_| real.is_none()) {
        let say = |summary: &RunSummary, folder: &Path| view.say(summary, folder);
        return simulate_in_view(
            live,
            results,
            &file_names(&scenario),
            (&scenario, &progress, console),
            &say,
        );
    }
    let summary = with_bar((&scenario.name(), scenario.ticks()), &progress, console, || {
        if real.is_some() {
            let left_behind = |summary| exit_with(view.say_left_behind(summary, folder));
            run_with_companions(live.as_ref(), &scenario, extensions, &results, &progress, &left_behind)
        } else {
            run_in_folder(&scenario, &results, &progress)
        }
    })?;
    view.say(&summary, folder)
}

/// Says what a declared delay of commands leaves of the phase margin.
fn note_delay(experiment: &Experiment, console: Console) {
    if let Some(margin) = loop_margin(experiment).filter(|margin| margin.delay_s > 0.0) {
        console.note(&margin.to_string());
    }
}

/// Says what this machine does not allow of real-time scheduling.
pub fn note_missing_real_time(robot: &RobotDefinition, console: Console) -> Result<(), FileError> {
    if let Some(missing) = robot.missing_real_time()? {
        let text = format!("note: {missing}: cycles may be late; `opspace doctor` says how to mend it");
        console.note(&text);
    }
    Ok(())
}

/// Data with which the results of a run are shown, also in the thread that watches the robots.
#[derive(Clone, Copy)]
struct RunView<'a> {
    scenario: &'a Scenario,
    args: &'a RunArgs,
    columns: &'a [Metric],
    progress: &'a Progress,
    /// State in which the driver leaves a real robot.
    state_after_run: Option<&'a str>,
    console: Console,
}

impl RunView<'_> {
    /// Shows the results of a run.
    fn say(self, summary: &RunSummary, folder: &Path) -> Outcome {
        let Self { scenario, args, progress, console, .. } = self;
        args.output.json.print(|| pretty(summary), || self.text(summary, folder))?;
        match summary.single() {
            Some(robot) => {
                say_end(robot, console);
                let expected = scenario.single().map_or(0, |experiment| experiment.task().file.expect.len());
                say_expectations(robot, expected, console);
                say_other_transformer(scenario, robot, progress, console);
                say_felt_force(scenario, robot, progress, console);
                say_written(robot, folder, console);
                self.say_state();
            }
            None => say_end_of_robots(summary, folder, console),
        }
        args.open.show(&folder.join(REPORT), console);
        Ok(exit_code(summary))
    }

    /// Says in which state a real robot is left.
    fn say_state(self) {
        if let Some(state) = self.state_after_run {
            self.console.note(state);
        }
    }

    /// Text of the results: what failed and the folder if quiet, without tables on a real robot, and with tables in simulation.
    fn text(self, summary: &RunSummary, folder: &Path) -> String {
        if self.console.quiet {
            return failures_and_folder(summary, folder);
        }
        match summary.single() {
            Some(robot) if !robot.simulated && !self.console.verbose => {
                owner_result(self.console, robot, self.scenario.ticks())
            }
            _ => text(summary, self.columns, self.console),
        }
    }

    /// Shows the results of a run whose robots cannot be reached.
    fn say_left_behind(self, summary: Result<RunSummary, RunError>, folder: &Path) -> Outcome {
        self.say(&summary?, folder)
    }
}

/// Ends the program with the outcome of a command, although another thread is blocked in a call of a driver.
fn exit_with(outcome: Outcome) {
    let exit = outcome.unwrap_or_else(|failure| report(&failure));
    std::process::exit(exit.code().into())
}

/// Refuses options that choose something for one robot: the file states it for each.
fn refuse_options_of_one_robot(args: &RunArgs) -> Result<(), Failure> {
    let given = [
        ("--robot", args.robot.is_some(), "robot"),
        ("--backend", args.backend.is_some(), "backend"),
        ("--controller", args.controller != ControllerKind::Osc, "controller"),
        ("--transformer", args.transformer.is_some(), "transformer"),
        ("--profile", args.profile.is_some(), "profile"),
    ];
    if args.move_to_start {
        let text =
            "--move-to-start is for a task of one robot: move each robot by its own task first".to_owned();
        return Err(Failure::Other(text, Exit::Bad));
    }
    match given.into_iter().find(|(_, is_given, _)| *is_given) {
        None => Ok(()),
        Some((option, _, key)) => Err(Failure::Other(
            format!(
                "{option} is for a task of one robot; this file states it for each: --set robots.NAME.{key}=..."
            ),
            Exit::Bad,
        )),
    }
}

/// Prints warnings about the URDF and the choice of the transformer, if verbose.
fn say_details(experiment: &Experiment, console: Console) {
    for warning in &experiment.robot().warnings {
        let code = warning.kind().code();
        console.detail(&format!("{}: {warning} [{code}]", experiment.robot().urdf.name()));
    }
    if let (Some(name), Some(reason)) = (experiment.transformer_name(), experiment.transformer_reason()) {
        console.detail(&format!("transformer '{name}': {reason}"));
    }
}

/// Folder of the results, unless another one is chosen.
fn default_folder(scenario: &Scenario, plant: &PlantChoice) -> PathBuf {
    let of_robot = scenario.single().map_or_else(String::new, |experiment| {
        format!("-{}-{}", experiment.robot().name(), experiment.options().backend.name())
    });
    let of_robot = if is_comparison(scenario) { "-beside".to_owned() } else { of_robot };
    let plant = plant.suffix();
    PathBuf::from(format!("runs/{}{of_robot}{plant}", scenario.name()))
}

/// Names of the files that a run writes to its folder.
fn file_names(scenario: &Scenario) -> Vec<String> {
    if scenario.single().is_some() {
        return [LOG, REPORT, SUMMARY].map(str::to_owned).into();
    }
    let of_robots = scenario
        .members
        .iter()
        .flat_map(|member| [LOG, REPORT, SUMMARY].map(|file| format!("{}/{file}", member.name)));
    [REPORT, SUMMARY].map(str::to_owned).into_iter().chain(of_robots).collect()
}

/// True for robots that run side by side for comparison.
fn is_comparison(scenario: &Scenario) -> bool {
    scenario.single().is_none() && scenario.couplings.is_empty() && scenario.objects.is_empty()
}

/// Describes the start of one robot, or names several; and whether they are simulated.
fn start_text(scenario: &Scenario, args: &RunArgs) -> Result<String, FileError> {
    let name = scenario.name();
    let world = |experiment: &Experiment| match experiment.driver_text() {
        None => "simulated: robot.toml has no [driver]".to_owned(),
        Some(_) if args.simulate => "simulated: --simulate asks for it".to_owned(),
        Some(driver) => format!("on the real robot: {driver}"),
    };
    if let Some(experiment) = scenario.single() {
        return Ok(format!("{name} ({}) {}", world(experiment), experiment.start_text()?));
    }
    let robots = scenario.members.iter();
    let robots = robots.map(|member| {
        let kind = member.experiment.options().backend.name();
        format!("{} ({kind} robot, {})", member.name, world(&member.experiment))
    });
    Ok(format!("{name}: {}", robots.collect::<Vec<_>>().join(", ")))
}

/// Moves the robot to the start of the task; returns the exit code if it does not arrive there.
fn move_to_start(
    experiment: &Experiment,
    extensions: &Extensions,
    folder: &Path,
    view: RunView<'_>,
) -> Result<Option<Exit>, Failure> {
    let folder = &folder.join(MOVE_TO_START);
    let left_behind = |summary| exit_with(view.say_left_behind(summary, folder));
    let begins = |motion: &Experiment| {
        let text = "moves to the start of the task within";
        view.console.note(&format!(
            "{text} {:.0} s, without looking for obstacles: keep its way clear",
            motion.duration_s()
        ));
    };
    let moved = opspace_report::move_to_start(
        experiment,
        extensions,
        folder,
        view.progress,
        (&begins, &left_behind),
    )?;
    let Some(moved) = moved.filter(|moved| exit_code_of_robot(moved) != Exit::Done) else { return Ok(None) };
    let RunView { args, columns, console, .. } = view;
    let results = || table(console, std::slice::from_ref(&moved), columns);
    args.output.json.print(|| pretty(&moved), || if console.quiet { String::new() } else { results() })?;
    say_end(&moved, console);
    view.say_state();
    console
        .note(&format!("not run: the robot did not reach the start of the task; see {}", folder.display()));
    Ok(Some(exit_code_of_robot(&moved)))
}

/// Text of the results: of one robot, or of the couplings of several.
fn text(summary: &RunSummary, columns: &[Metric], console: Console) -> String {
    match summary.single() {
        Some(robot) => table(console, std::slice::from_ref(robot), columns),
        None if summary.couplings.is_empty() => {
            let robots: Vec<Summary> = summary.robots.values().cloned().collect();
            table(console, &robots, columns)
        }
        None => {
            let of_robot = |(name, robot): (&String, &Summary)| {
                headline(robot).iter().map(|line| format!("{name}: {line}\n")).collect::<String>()
            };
            let ends: String = summary.robots.iter().map(of_robot).collect();
            format!("{ends}\n{}", render(&coupling_table(std::slice::from_ref(summary))))
        }
    }
}

/// Prints the problems that `opspace check` finds, a line each, unless quiet.
fn note_problems(scenario: &Scenario, args: &RunArgs, extensions: &Extensions, console: Console) {
    if console.quiet {
        return;
    }
    let of_robots = scenario.experiments().flat_map(|experiment| problems(extensions, experiment));
    let mut lines: Vec<String> = Vec::new();
    for finding in of_robots.chain(coupling_diagnostics(scenario)) {
        let line = format!("note: [{}] {finding}", finding.code);
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    lines.iter().for_each(|line| console.note(line));
    if !lines.is_empty() {
        let options = if has_options_of_check(args) { " with the same options" } else { "" };
        let what = if lines.len() == 1 { "this problem" } else { "these problems" };
        console.note(&format!("note: `opspace check {}`{options} explains {what}", args.task.display()));
    }
}

/// Prints the warnings of drivers before anything is opened.
fn note_doubts_of_drivers(
    scenario: &Scenario,
    extensions: &Extensions,
    console: Console,
) -> Result<(), FileError> {
    for experiment in scenario.experiments() {
        for doubt in experiment.check_driver(extensions)? {
            console.note(&format!("warning: {doubt} [{}]", doubt.code));
        }
    }
    Ok(())
}

/// True if `opspace check` needs options to examine the same run.
fn has_options_of_check(args: &RunArgs) -> bool {
    args.robot.is_some()
        || args.backend.is_some()
        || args.controller != ControllerKind::Osc
        || args.transformer.is_some()
        || !args.set.is_empty()
}

/// Says that a complete run met its expectations; those that it missed are in the results.
fn say_expectations(summary: &Summary, number: usize, console: Console) {
    let is_complete = summary.faulted.is_none() && !summary.interrupted;
    if number > 0 && is_complete && summary.missed_expectations.is_empty() {
        console.note(&match number {
            1 => "the expectation is met".to_owned(),
            _ => format!("all {number} expectations are met"),
        });
    }
}

/// Names the transformer to try after a run whose torque error is large, and what a repeated simulation gives with it.
fn say_other_transformer(scenario: &Scenario, summary: &Summary, progress: &Progress, console: Console) {
    let is_complete = summary.faulted.is_none() && !summary.interrupted;
    if console.quiet || !is_complete {
        return;
    }
    match scenario.other_transformer(summary, progress) {
        Ok(None) => {}
        Ok(Some(other)) => console.note(&format!("NOTE {other}")),
        Err(error) => {
            let check = format!("`opspace check -v {}` lists what its parts leave", scenario.source.name());
            let text = "NOTE the torque error is large, but no other transformer suits";
            console.note(&format!("{text}: {error}; {check}"));
        }
    }
}

/// Says what a person feels on a real robot that was simulated, beside a torque robot and without friction compensation.
fn say_felt_force(scenario: &Scenario, summary: &Summary, progress: &Progress, console: Console) {
    // What cannot be repeated is not compared.
    if let (false, Ok(Some(felt))) = (console.quiet, scenario.felt_force(summary, progress)) {
        console.note(&format!("{felt}"));
    }
}

/// Prints why robots were held, what failed, and where the results are.
fn say_end_of_robots(summary: &RunSummary, folder: &Path, console: Console) {
    for hold in &summary.holds {
        console.note(&format!("{} was held from {:.3} s: {}", hold.robot, hold.from_s, hold.reason));
    }
    for failure in summary.failures() {
        console.note(&failure);
    }
    for (name, robot) in &summary.robots {
        let findings = robot.findings.notes().map(note);
        let finals = final_notes(robot).into_iter().map(|text| format!("NOTE {text}"));
        for text in findings.chain(finals) {
            console.note(text.trim_end().replacen("NOTE ", &format!("NOTE {name}: "), 1).as_str());
        }
    }
    if summary.not_saved.is_empty() {
        console.note(&format!("wrote {}, and a folder for each robot", folder.join(REPORT).display()));
    }
}

/// Prints the reason why a run ended early.
fn say_end(summary: &Summary, console: Console) {
    if let Some(time_s) = summary.interrupted_time_s {
        console.note(&format!("interrupted at {time_s:.3} s; the log is closed"));
    }
    say_fault(summary, console);
}
