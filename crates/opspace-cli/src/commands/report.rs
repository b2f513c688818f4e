//! `opspace report`: creates one page about logs.

use crate::cli::ReportArgs;
use crate::console::{Console, Exit, Failure, Outcome};
use crate::output::{REPORT, pretty, read_log, write};
use opspace_experiment::evaluate::results::MEASURES;
use opspace_experiment::report::document::{RunSection, page};
use opspace_experiment::{Experiment, Extensions, RunError};
use opspace_log::OutcomeRecord;

pub fn report(args: &ReportArgs, extensions: &Extensions, console: Console) -> Outcome {
    let mut shown = Vec::new();
    let mut exit = Exit::Done;
    let mut first = None;
    for path in &args.logs {
        let (path, recording) = read_log(path)?;
        let bad = |error: RunError| Failure::Other(format!("{}: {error}", path.display()), Exit::Bad);
        let experiment = Experiment::of_log_with(extensions, &recording).map_err(bad)?;
        if let Some(damage) = &recording.damage {
            console.note(&format!("{}: damaged: {damage}", path.display()));
            exit = Exit::DataLost;
        }
        if recording.dropped() > 0 {
            exit = Exit::DataLost;
        }
        let summary = experiment.summary(&recording, &OutcomeRecord::of(&recording), None);
        shown.push(RunSection::new(&experiment, &recording, summary));
        first.get_or_insert(path);
    }
    let summaries: Vec<_> = shown.iter().map(|s| s.summary.clone()).collect();
    let title = match shown.as_slice() {
        [one] => one.title.clone(),
        many => format!("{} runs", many.len()),
    };
    let lead = "Desired and actual behaviour of the robot, from its log.";
    let beside = first.map(|log| log.with_file_name(REPORT));
    let out = args.out.clone().or(beside).unwrap_or_else(|| REPORT.into());
    write(&out, &page(&title, lead, &summaries, MEASURES, &shown))?;
    args.json.print(|| pretty(&summaries), || format!("{}\n", out.display()))?;
    Ok(exit)
}
