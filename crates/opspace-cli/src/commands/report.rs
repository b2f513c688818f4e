//! `opspace report`: creates one page about logs.

use crate::cli::ReportArgs;
use crate::commands::report_coupled::report_coupled;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::output::{Format, log_path, logs_of_experiment, open_log, pretty, write_named};
use crate::outputs::check_outputs;
use opspace_experiment::metrics::metric::default_columns;
use opspace_experiment::report::document::{RunSection, page};
use opspace_experiment::run::result_files::REPORT;
use opspace_experiment::{Experiment, Extensions, RunError};
use opspace_log::OutcomeRecord;
use std::path::{Path, PathBuf};

pub fn report(args: &ReportArgs, extensions: &Extensions, console: Console) -> Outcome {
    if let Some(folder) = args.logs.iter().find(|path| !logs_of_experiment(path).is_empty()) {
        return report_coupled(args, folder, extensions, console);
    }
    let logs: Vec<PathBuf> = args.logs.iter().map(|path| log_path(path)).collect();
    let beside = logs.first().map(|log| log.with_file_name(REPORT));
    let out = args.out.clone().or(beside).unwrap_or_else(|| REPORT.into());
    let outputs: Vec<PathBuf> =
        [Some(out.as_path()), args.json.path()].into_iter().flatten().map(Path::to_owned).collect();
    check_outputs(&logs, &outputs)?;
    let mut shown = Vec::new();
    let mut exit = Exit::Done;
    for path in &args.logs {
        let (path, log) = open_log(path)?;
        let recording = log.recording();
        let bad = |error: RunError| Failure::Other(format!("{}: {error}", path.display()), Exit::Bad);
        if let Some(damage) = &recording.damage {
            console.note(&format!("{}: damaged: {damage}", path.display()));
            exit = Exit::DataLost;
        }
        let experiment = Experiment::of_log_with(extensions, recording).map_err(bad)?;
        if recording.dropped() > 0 {
            exit = Exit::DataLost;
        }
        let summary = experiment.summary_of_file(&log, &OutcomeRecord::of(recording), None).map_err(bad)?;
        shown.push(RunSection::of_file(&experiment, &log, summary).map_err(bad)?);
    }
    let summaries: Vec<_> = shown.iter().map(|s| s.summary.clone()).collect();
    let title = match shown.as_slice() {
        [one] => one.title.clone(),
        many => format!("{} runs", many.len()),
    };
    let lead = "Desired and actual behaviour of the robot, from its log.";
    write_named(
        &out,
        &page(&title, lead, &summaries, &default_columns(extensions.added()), &shown),
        Format::Html,
    )?;
    args.json.print(|| pretty(&summaries), || format!("{}\n", out.display()))?;
    args.open.show(&out, console);
    Ok(exit)
}
