//! Results of a suite: table, page, JSON, CSV, and the comparison with a baseline.

use crate::cli::SuiteOutputArgs;
use crate::console::{
    Console, Exit, Failure, Outcome, premises, print_exactly, render, report, results, with_notes,
};
use crate::output::{Format, pretty, write, write_named};
use crate::result_folder::{LOGS, ROWS};
use crate::run_progress::exit_code;
use opspace_experiment::evaluate::coupling_sentences::coupling_sentences;
use opspace_experiment::evaluate::results::{group_rows, has_value};
use opspace_experiment::metrics::columns::columns_named;
use opspace_experiment::run::result_files::{REPORT, ResultFolder};
use opspace_experiment::{Experiment, Extensions, Metric, RunSummary, Source, Summary};
use opspace_log::LogFile;
use opspace_model::files::open_file;
use opspace_report::coupling_pages::coupling_suite_page;
use opspace_report::coupling_table::{coupling_notes, coupling_table};
use opspace_report::document::{RunSection, page};
use opspace_suite::baseline::{Baseline, BaselineComparison, TOLERANCE, Verdict};
use opspace_suite::csv::csv;
use opspace_suite::suite_rows::{SUITE_ROWS, SuiteRows};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Maximum number of lines of each list of runs.
const MAX_LISTED: usize = 10;

const LEAD: &str = "A transformer converts desired torques into setpoints, the commands of position or velocity servos; ik is \
                    inverse kinematics without torque control. The profile is the set of servo parameters and rates; 1:n means \
                    a setpoint every n servo ticks.";

impl SuiteOutputArgs {
    /// Files outside the folder of results to which the command writes.
    pub fn outputs(&self) -> Vec<PathBuf> {
        let csv = self.csv.as_deref().filter(|path| !is_stdout(path));
        [self.output.json.path(), csv].into_iter().flatten().map(Path::to_owned).collect()
    }

    /// Files that the command may overwrite: a default folder is moved aside, so that the results in it can be the
    /// baseline.
    pub fn overwritten(&self, files: &[String]) -> Vec<PathBuf> {
        let chosen = self.output.out.iter().flat_map(|out| files.iter().map(|name| out.join(name)));
        chosen.chain(self.outputs()).collect()
    }

    /// Reads the baseline, if any, and refuses contradictory outputs.
    pub fn check(&self) -> Result<Option<Baseline>, Failure> {
        let printed = |path: &Option<PathBuf>| path.as_deref().is_some_and(is_stdout);
        if printed(&self.csv) && printed(&self.output.json.json) {
            return Err(Failure::Other("--json and --csv cannot both be `-`".to_owned(), Exit::Bad));
        }
        let Some(path) = &self.baseline else { return Ok(None) };
        let text =
            open_file(path).and_then(std::io::read_to_string).map_err(|error| match Source::read(path) {
                // The same message as for any other file.
                Err(unread) => Failure::from(unread),
                Ok(_) => Failure::io("cannot be read", path, &error),
            })?;
        let refused = |words: String| Failure::Other(format!("{}: {words}", path.display()), Exit::Bad);
        Baseline::parse(&text).map(Some).map_err(refused)
    }

    /// Fails if the baseline has none of the runs.
    pub fn refuse_foreign(&self) -> Failure {
        let path = self.baseline.as_deref().unwrap_or(Path::new(""));
        let text = format!(
            "{}: has none of the runs of this suite: no task, robot, controller, profile, settings and seed are equal",
            path.display()
        );
        Failure::Other(text, Exit::Bad)
    }
}

fn is_stdout(path: &Path) -> bool {
    path == Path::new("-")
}

/// The worst of the exit codes of runs.
fn worst(codes: &[Exit]) -> Exit {
    let worst = [Exit::Failed, Exit::Interrupted, Exit::DataLost].into_iter().find(|e| codes.contains(e));
    worst.unwrap_or(Exit::Done)
}

/// Results of a suite in a folder.
pub struct SuiteResults {
    /// Folder of the results.
    pub folder: ResultFolder,
    /// Rows of the complete runs.
    pub rows: SuiteRows,
    /// Summaries to be shown, in the order of the suite: those of the rows, and of runs that were interrupted.
    pub summaries: Vec<RunSummary>,
    /// True if results without all runs are final; otherwise they leave no `bench.json`, and can be continued.
    pub partial: bool,
}

impl SuiteResults {
    /// Writes and prints the results, and returns the exit code that they give.
    pub fn write(
        &self,
        args: &SuiteOutputArgs,
        baseline: Option<&Baseline>,
        extensions: &Extensions,
        console: Console,
    ) -> Outcome {
        let (header, folder) = (&self.rows.header, self.folder.path());
        let several = header.has_several_robots();
        let summaries = RunSummary::of_single_robots(&self.summaries);
        let added = extensions.added::<Metric>();
        let names = header.columns.iter().map(String::as_str);
        let columns = columns_named(names, added).unwrap_or_default();
        let comparison = baseline.map(|baseline| baseline.compare(&summaries, added));
        let (page, logs) =
            if several { self.page_of_robots() } else { self.page(&summaries, &columns, extensions) };
        write(&folder.join(REPORT), &page)?;
        let json = self.json(&summaries, &logs, comparison.as_ref());
        let is_final = self.partial || self.rows.missing().is_empty();
        if is_final {
            write(&folder.join(ROWS), &json)?;
        }
        if let Some(path) = args.csv.as_deref().filter(|path| !is_stdout(path)) {
            write_named(path, &csv(&self.summaries), Format::Csv)?;
        }
        if args.csv.as_deref().is_some_and(is_stdout) {
            if let Some(path) = args.output.json.path() {
                write_named(path, &json, Format::Json)?;
            }
            print_exactly(&csv(&self.summaries))?;
        } else {
            let text = || {
                if several {
                    return coupling_results(console, &self.summaries);
                }
                let compared = comparison.as_ref().map(|comparison| compared(comparison, console));
                results(console, &summaries, &columns) + &compared.unwrap_or_default()
            };
            args.output.json.print(|| json.clone(), text)?;
        }
        let rows = if is_final { format!("{ROWS}, {SUITE_ROWS}") } else { SUITE_ROWS.to_owned() };
        let kept = match (several, logs.len()) {
            (true, 1) => "folder of a run",
            (true, _) => "folders of runs",
            (false, 1) => "log",
            (false, _) => "logs",
        };
        console.note(&format!("wrote {}, {rows} and {} {kept}", folder.join(REPORT).display(), logs.len()));
        let mut codes: Vec<Exit> = self.summaries.iter().map(exit_code).collect();
        if let Some(comparison) = &comparison {
            list_unmatched(comparison, console);
            codes.extend(comparison.is_worse().then_some(Exit::Failed));
        }
        for column in self.empty_columns(&summaries, &columns) {
            let text = format!("no run has a value for the column `{column}`, which the suite lists");
            codes.push(report(&Failure::Other(text, Exit::Failed)));
        }
        Ok(worst(&codes))
    }

    /// Returns the exit code of a suite that may have been interrupted: `exit` is that of the results.
    pub fn ended(&self, exit: Exit, console: Console) -> Exit {
        let missing = self.rows.missing().len();
        if missing == 0 {
            return exit;
        }
        let runs = self.rows.header.numbers().count();
        console
            .note(&format!("interrupted: {missing} of {runs} runs are missing; the same command continues"));
        if exit == Exit::Failed { exit } else { Exit::Interrupted }
    }

    /// Formats the results as JSON.
    fn json(
        &self,
        summaries: &[Summary],
        logs: &[String],
        comparison: Option<&BaselineComparison>,
    ) -> String {
        let header = &self.rows.header;
        let several = header.has_several_robots();
        let mut json = json!({
            "schema": if several { "opspace.coupled-bench/1" } else { "opspace.bench/1" },
            "opspace_version": header.opspace_version,
            "suite_sha256": header.suite_sha256,
            "title": header.title,
            "runs": header.runs,
        });
        if let Some(shard) = header.shard {
            json["shard"] = shard.to_string().into();
        }
        let missing = self.rows.missing();
        if !missing.is_empty() {
            json["missing"] = missing.into();
        }
        json["rows"] = json!(self.summaries);
        if !several {
            json["groups"] = json!(group_rows(summaries));
        }
        json[LOGS] = json!(logs);
        if let Some(comparison) = comparison {
            json["comparison"] = comparison_json(comparison);
        }
        pretty(&json)
    }

    /// Columns that the suite lists and for which no run has a value, if all runs of the suite are there.
    fn empty_columns(&self, summaries: &[Summary], columns: &[Metric]) -> Vec<&'static str> {
        let header = &self.rows.header;
        if !header.columns_required || header.shard.is_some() || !self.rows.missing().is_empty() {
            return Vec::new();
        }
        let empty = columns.iter().filter(|metric| !has_value(summaries, metric));
        empty.filter_map(|metric| Some(metric.column?.name)).collect()
    }

    /// Page with sections of the runs whose logs are in the folder, and the names of these logs.
    fn page(
        &self,
        summaries: &[Summary],
        columns: &[Metric],
        extensions: &Extensions,
    ) -> (String, Vec<String>) {
        let kept = self.rows.rows.values().filter_map(|row| {
            let name = row.log.clone()?;
            let log = LogFile::open(self.folder.path().join(&name)).ok()?;
            let experiment = Experiment::of_log_with(extensions, log.recording()).ok()?;
            let summary = row.row.single()?.clone();
            Some((RunSection::of_file(&experiment, &log, summary).ok()?, name))
        });
        let (shown, logs): (Vec<RunSection>, Vec<String>) = kept.unzip();
        let header = &self.rows.header;
        let lead = format!("{} runs in simulation. {LEAD}", summaries.len());
        (page(&header.title, &lead, summaries, columns, &shown), logs)
    }

    /// Page that refers to those of the runs whose logs are in folders, and the names of these folders.
    fn page_of_robots(&self) -> (String, Vec<String>) {
        let kept = self.rows.rows.values().filter_map(|row| {
            let folder = row.log.clone()?;
            Some(((row.row.title(), format!("{folder}/{REPORT}")), folder))
        });
        let (pages, folders): (Vec<(String, String)>, Vec<String>) = kept.unzip();
        (coupling_suite_page(&self.rows.header.title, &self.summaries, &pages), folders)
    }
}

/// Text of the results of runs of several robots: failures, table and notes.
fn coupling_results(console: Console, summaries: &[RunSummary]) -> String {
    let robots = summaries.iter().flat_map(|summary| summary.robots.values());
    let mut text = match summaries {
        [one] => coupling_sentences(one).iter().map(|sentence| format!("{sentence}\n")).collect(),
        _ => String::new(),
    };
    text += &premises(console, robots);
    for summary in summaries {
        for failure in summary.failures() {
            text += &format!("FAILED {}: {failure}\n", summary.title());
        }
    }
    text += &render(&coupling_table(summaries));
    with_notes(console, text, &coupling_notes(summaries))
}

fn comparison_json(comparison: &BaselineComparison) -> Value {
    let mut json = json!({ "tolerance": TOLERANCE, "confidence": 0.95 });
    if let (Some(json), Ok(Value::Object(parts))) = (json.as_object_mut(), serde_json::to_value(comparison)) {
        json.extend(parts);
    }
    json
}

/// Renders the comparison with a baseline.
fn compared(comparison: &BaselineComparison, console: Console) -> String {
    let table = comparison.table();
    let count = |verdict| comparison.count(verdict);
    let mut text = format!(
        "\nCompared with the baseline: {} metrics: {} worse, {} better, {} the same, {} changed\n",
        comparison.metrics.len(),
        count(Verdict::Worse),
        count(Verdict::Better),
        count(Verdict::Same),
        count(Verdict::Changed),
    );
    if !table.rows.is_empty() {
        text += &render(&table);
    }
    if console.verbose {
        text += &format!(
            "\nMeans over the pairs of runs with equal seeds; ± is half of the 95 % confidence interval of the mean \
             difference (Student's t). A metric is better or worse if this interval excludes zero and the means differ by \
             more than {} %. With one pair, only the latter counts. 'changed': neither better nor worse.\n",
            100.0 * TOLERANCE
        );
    }
    text
}

/// Lists the runs that are in only one of the two results, and those that fail now.
fn list_unmatched(comparison: &BaselineComparison, console: Console) {
    for (title, list) in [
        ("fails, but did not in the baseline", &comparison.newly_failed),
        ("has no value any more", &comparison.lost),
        ("only in the baseline", &comparison.only_baseline),
        ("not in the baseline", &comparison.only_new),
    ] {
        for text in list.iter().take(MAX_LISTED) {
            console.note(&format!("{title}: {text}"));
        }
        if list.len() > MAX_LISTED {
            console.note(&format!("{title}: {} more", list.len() - MAX_LISTED));
        }
    }
}
