//! Results of suites: rows as JSON lines, and files of `opspace bench`, which later suites are compared with.

use crate::edits::{apply, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::{CORPUS, root};
use opspace_experiment::evaluate::notes::notes;
use opspace_experiment::evaluate::results::{failures, group_rows, table};
use opspace_experiment::metrics::columns::columns_named;
use opspace_experiment::{Files, Progress, RunSummary};
use opspace_report::document::page;
use opspace_suite::Suite;
use opspace_suite::baseline::Baseline;
use opspace_suite::csv::csv;
use opspace_suite::suite_rows::{SuiteHeader, SuiteRow, SuiteRows};
use serde_json::{Value, json};

/// Most memory for one file, bytes.
const MOST_BYTES: usize = 64 << 20;

/// Largest number of runs of a suite.
const MAX_RUNS: usize = 100_000;

/// Largest mean of a metric whose square is far from the largest number.
const LARGEST: f64 = 1e100;

/// Accepted rows are those that their text gives when it is read again; their number is that of a suite. The table, the
/// page and the CSV of accepted rows are made, and the page and the CSV escape the texts in them.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn rows() {
    let rows = suite_rows();
    let mut shard = rows.clone();
    shard.header.shard = "1/2".parse().ok();
    let seeds = [rows.text(), shard.text()];
    let target = Target::new("rows", MOST_BYTES);
    for_each_input(edited(seeds.len()), 400, |(seed, edits)| {
        let bytes = apply(&seeds, *seed, edits);
        target.check(&bytes, edits.is_empty(), || {
            let Some(rows) = SuiteRows::parse(&bytes) else { return false };
            assert!(rows.header.runs <= MAX_RUNS, "{} runs", rows.header.runs);
            assert!(rows.rows.keys().all(|run| rows.header.numbers().any(|number| number == *run)));
            let again = SuiteRows::parse(rows.text().as_bytes()).expect("the same rows");
            assert_eq!(again.text(), rows.text());
            let summaries: Vec<RunSummary> = rows.rows.values().map(|row| row.row.clone()).collect();
            check_summaries(&summaries, &rows.header);
            true
        });
    });
}

fn check_summaries(runs: &[RunSummary], header: &SuiteHeader) {
    if header.has_several_robots() {
        return;
    }
    let summaries = &RunSummary::of_single_robots(runs)[..];
    let columns = columns_named(header.columns.iter().map(String::as_str), &[]).unwrap_or_default();
    let shown = table(summaries, &columns);
    assert!(summaries.is_empty() || !shown.rows.is_empty());
    let _ = (notes(summaries, &columns), failures(summaries));
    let groups = group_rows(summaries);
    let counted: usize = groups.iter().map(|group| group["seeds"].as_array().map_or(0, Vec::len)).sum();
    assert_eq!(counted, summaries.len(), "a run is in no group, or in two");
    let html = page(&header.title, "Results.", summaries, &columns, &[]);
    assert!(!html.contains("<fuzz>"), "text of the rows is in the page without escapes");
    let text = csv(runs);
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(text.as_bytes());
    let lines: Vec<csv::StringRecord> =
        reader.records().map(|line| line.expect("as many cells in each line")).collect();
    assert_eq!(lines.len(), 1 + summaries.len());
}

/// An error has a text. The comparison with an accepted baseline has finite numbers, unless they overflow; a baseline
/// compared with itself has no metric that is worse or better.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn baseline() {
    let rows = suite_rows();
    let runs: Vec<RunSummary> = rows.rows.values().map(|row| row.row.clone()).collect();
    let summaries = RunSummary::of_single_robots(&runs);
    let file = json!({
        "schema": "opspace.bench/1",
        "title": rows.header.title,
        "runs": rows.header.runs,
        "rows": summaries,
        "groups": group_rows(&summaries),
    });
    // With and without lines, of which the edits make use.
    let seeds = [serde_json::to_string_pretty(&file).expect("JSON"), file.to_string()];
    let target = Target::new("baseline", MOST_BYTES);
    for_each_input(edited(seeds.len()), 400, |(seed, edits)| {
        let text = String::from_utf8_lossy(&apply(&seeds, *seed, edits)).into_owned();
        target.check(text.as_bytes(), edits.is_empty(), || {
            let baseline = match Baseline::parse(&text) {
                Ok(baseline) => baseline,
                Err(error) => {
                    assert!(!error.trim().is_empty());
                    return false;
                }
            };
            let comparison = baseline.compare(&summaries, &[]);
            if edits.is_empty() {
                assert!(!comparison.is_worse() && !comparison.metrics.is_empty());
            }
            for metric in comparison.metrics.iter().filter(|metric| metric.baseline.abs() < LARGEST) {
                let numbers = [metric.baseline, metric.new, metric.difference];
                assert!(numbers.iter().chain(&metric.half_width).all(|x| x.is_finite()), "{metric:?}");
            }
            let _ = comparison.table();
            let written: Value = serde_json::to_value(&comparison).expect("JSON");
            assert_eq!(written["metrics"].as_array().map(Vec::len), Some(comparison.metrics.len()));
            true
        });
    });
}

/// Rows of a small suite: three short runs, one with two seeds.
fn suite_rows() -> SuiteRows {
    let suite = Suite::load(Files::Disk, &root(&format!("{CORPUS}/results.toml"))).expect("a suite");
    let mut rows = SuiteRows::new(SuiteHeader::new(&suite, "results", None));
    for (place, run) in suite.runs.iter().enumerate() {
        let mut summary = run.run_without_logs(&Progress::default()).expect("a run");
        summary.robots.values_mut().for_each(|robot| robot.timing.realtime_factor = Some(10.0));
        rows.rows.insert(place + 1, SuiteRow::new(place + 1, Some(format!("{place}.mcap")), summary));
    }
    assert!(rows.rows.len() > 2);
    rows
}
