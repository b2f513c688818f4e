//! `opspace report`: creates one page about logs: of single robots, or of the robots of an experiment.

use crate::cli::ReportArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::output::{Format, logs_of_experiment, logs_of_robots, logs_of_run, open_log, pretty, write_named};
use crate::outputs::check_outputs;
use opspace_experiment::evaluate::position_control::position_control_notes;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::run::membership::Membership;
use opspace_experiment::run::result_files::REPORT;
use opspace_experiment::{Experiment, Extensions, RunError, Scenario, Summary};
use opspace_log::{LogFile, OutcomeRecord, Recording};
use opspace_report::document::{RunSection, page, title_of_runs};
use opspace_report::summary_and_page;
use std::path::{Path, PathBuf};

/// Page, and the summaries in it as JSON.
struct Report {
    page: String,
    json: String,
}

pub fn report(args: &ReportArgs, extensions: &Extensions, console: Console) -> Outcome {
    let folder = args.logs.iter().find(|path| !logs_of_experiment(path).is_empty());
    if let Some(folder) = folder.filter(|_| args.logs.len() > 1) {
        let text = format!(
            "{}: the folder of an experiment with several robots makes a page alone; for one page with other runs, name the folders of its robots",
            folder.display()
        );
        return Err(Failure::Other(text, Exit::Bad));
    }
    // Robots that ran side by side are compared, as other runs of one robot each are.
    let paths: Vec<PathBuf> = args.logs.iter().flat_map(|path| logs_of_run(path)).collect();
    let beside = match args.logs.as_slice() {
        [several] if !logs_of_robots(several).is_empty() => Some(several.join(REPORT)),
        _ => paths.first().map(|log| log.with_file_name(REPORT)),
    };
    let out = args.out.clone().or(beside).unwrap_or_else(|| REPORT.into());
    let outputs: Vec<PathBuf> =
        [Some(out.as_path()), args.json.path()].into_iter().flatten().map(Path::to_owned).collect();
    check_outputs(&paths, &outputs)?;
    let mut exit = Exit::Done;
    let mut logs = Vec::new();
    for path in &paths {
        let (path, log) = open_log(path)?;
        if let Some(damage) = &log.recording().damage {
            console.note(&format!("{}: damaged: {damage}", path.display()));
            exit = Exit::DataLost;
        }
        if log.recording().dropped() > 0 {
            exit = Exit::DataLost;
        }
        logs.push((path, log));
    }
    let Report { page, json } = match folder {
        Some(folder) => of_experiment(folder, logs, extensions)?,
        None => of_single_robots(&logs, extensions, console)?,
    };
    write_named(&out, &page, Format::Html)?;
    args.json.print(|| json, || format!("{}\n", out.display()))?;
    args.open.show(&out, console);
    Ok(exit)
}

fn bad(path: &Path) -> impl Fn(RunError) -> Failure {
    move |error| Failure::Other(format!("{}: {error}", path.display()), Exit::Bad)
}

fn summary(experiment: &Experiment, log: &LogFile) -> Result<Summary, RunError> {
    experiment.summary_of_file(log, &OutcomeRecord::of(log.recording()), None)
}

/// Report about runs of one robot each.
fn of_single_robots(
    logs: &[(PathBuf, LogFile)],
    extensions: &Extensions,
    console: Console,
) -> Result<Report, Failure> {
    let shown = logs.iter().map(|(path, log)| {
        let section = || {
            let experiment = Experiment::of_log_with(extensions, log.recording())?;
            RunSection::of_file(&experiment, log, summary(&experiment, log)?)
        };
        section().map_err(bad(path))
    });
    let shown = shown.collect::<Result<Vec<_>, _>>()?;
    let summaries: Vec<_> = shown.iter().map(|s| s.summary.clone()).collect();
    position_control_notes(&summaries).iter().for_each(|note| console.note(&format!("NOTE {note}")));
    let title = title_of_runs(&shown);
    let lead = "Desired and actual behaviour of the robot, from its log.";
    Ok(Report {
        page: page(&title, lead, &summaries, &default_columns(extensions.added()), &shown),
        json: pretty(&summaries),
    })
}

/// Report about the run of several robots whose logs are in `folder`.
fn of_experiment(
    folder: &Path,
    logs: Vec<(PathBuf, LogFile)>,
    extensions: &Extensions,
) -> Result<Report, Failure> {
    let mut named = Vec::new();
    for (_, log) in logs {
        let membership = Membership::of_log(log.recording()).map_err(bad(folder))?;
        named.push((membership.map_or_else(String::new, |membership| membership.robot), log));
    }
    // In the order of the robots' names, as the members.
    named.sort_by(|(a, _), (b, _)| a.cmp(b));
    let logs: Vec<LogFile> = named.into_iter().map(|(_, log)| log).collect();
    let recordings: Vec<&Recording> = logs.iter().map(LogFile::recording).collect();
    let report = || {
        let scenario = Scenario::of_logs(extensions, &recordings)?;
        let summaries = scenario.experiments().zip(&logs).map(|(experiment, log)| summary(experiment, log));
        let (summary, page) = summary_and_page(&scenario, &logs, summaries.collect::<Result<_, _>>()?)?;
        Ok(Report { page, json: pretty(&summary) })
    };
    report().map_err(bad(folder))
}
