//! `opspace report` of an experiment with several robots.

use crate::cli::ReportArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::output::{Format, logs_of_experiment, open_log, pretty, write_named};
use crate::outputs::check_outputs;
use opspace_experiment::run::membership::Membership;
use opspace_experiment::run::result_files::REPORT;
use opspace_experiment::{CoupledExperiment, Extensions, RunError};
use opspace_log::{LogFile, OutcomeRecord, Recording};
use std::path::{Path, PathBuf};

/// Creates the page about the experiment whose robots have their logs in `folder`.
pub fn report_coupled(
    args: &ReportArgs,
    folder: &Path,
    extensions: &Extensions,
    console: Console,
) -> Outcome {
    if args.logs.len() > 1 {
        let text = format!(
            "{}: the folder of an experiment with several robots makes a page alone; for one page with other runs, name the folders of its robots",
            folder.display()
        );
        return Err(Failure::Other(text, Exit::Bad));
    }
    let paths = logs_of_experiment(folder);
    let out = args.out.clone().unwrap_or_else(|| folder.join(REPORT));
    let outputs: Vec<PathBuf> =
        [Some(out.as_path()), args.json.path()].into_iter().flatten().map(Path::to_owned).collect();
    check_outputs(&paths, &outputs)?;
    let bad = |error: RunError| Failure::Other(format!("{}: {error}", folder.display()), Exit::Bad);
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
        logs.push((robot(&log).map_err(bad)?, log));
    }
    let recordings: Vec<&Recording> = logs.iter().map(|(_, log)| log.recording()).collect();
    let experiment = CoupledExperiment::of_logs(extensions, &recordings).map_err(bad)?;
    // In the order of the robots' names, as the members.
    logs.sort_by(|(a, _), (b, _)| a.cmp(b));
    let logs: Vec<LogFile> = logs.into_iter().map(|(_, log)| log).collect();
    let summaries = experiment.members.iter().zip(&logs).map(|(member, log)| {
        member.experiment.summary_of_file(log, &OutcomeRecord::of(log.recording()), None)
    });
    let summaries = summaries.collect::<Result<Vec<_>, _>>().map_err(bad)?;
    let (summary, page) = experiment.summary_and_page(&logs, summaries).map_err(bad)?;
    write_named(&out, &page, Format::Html)?;
    args.json.print(|| pretty(&summary), || format!("{}\n", out.display()))?;
    args.open.show(&out, console);
    Ok(exit)
}

/// Name of the robot that wrote a log.
fn robot(log: &LogFile) -> Result<String, RunError> {
    Ok(Membership::of_log(log.recording())?.map_or_else(String::new, |membership| membership.robot))
}
