//! Results of a suite of experiments with several robots: table, page, JSON and CSV.

use crate::cli::SuiteOutputArgs;
use crate::console::{Console, Exit, Outcome, print_exactly, render, with_notes};
use crate::output::{Format, pretty, write, write_named};
use crate::result_folder::{LOGS, ROWS};
use crate::run_progress::coupled_exit_code;
use crate::suite_results::{is_stdout, worst};
use crate::sweep::Executed;
use opspace_experiment::evaluate::coupled_summary::CoupledSummary;
use opspace_experiment::evaluate::csv::coupled_csv;
use opspace_experiment::evaluate::notes::{allowed_notes, assumed_notes};
use opspace_experiment::report::coupled_suite_page::coupled_suite_page;
use opspace_experiment::report::coupled_table::{coupling_notes, coupling_table};
use opspace_experiment::run::result_files::REPORT;
use opspace_experiment::suites::suite_rows::SUITE_ROWS;
use serde_json::json;

/// Writes and prints the results, and returns the exit code that they give.
pub fn write_coupled(done: &Executed<CoupledSummary>, args: &SuiteOutputArgs, console: Console) -> Outcome {
    let (header, rows, summaries, folder) =
        (&done.rows.header, &done.rows.rows, &done.summaries, done.folder.path());
    let logs: Vec<&String> = rows.values().filter_map(|row| row.log.as_ref()).collect();
    let page_of = |log: &String| format!("{log}/{REPORT}");
    let pages: Vec<(String, String)> =
        rows.values().filter_map(|row| Some((row.row.title(), page_of(row.log.as_ref()?)))).collect();
    write(&folder.join(REPORT), &coupled_suite_page(&header.title, summaries, &pages))?;
    let missing: Vec<usize> = header.numbers().filter(|number| !rows.contains_key(number)).collect();
    let is_final = missing.is_empty();
    let mut json = json!({
        "schema": "opspace.coupled-bench/1",
        "opspace_version": header.opspace_version,
        "suite_sha256": header.suite_sha256,
        "title": header.title,
        "runs": header.runs,
        "rows": summaries,
        LOGS: logs,
    });
    if !is_final {
        json["missing"] = missing.into();
    }
    let json = pretty(&json);
    if is_final {
        write(&folder.join(ROWS), &json)?;
    }
    if let Some(path) = args.csv.as_deref().filter(|path| !is_stdout(path)) {
        write_named(path, &coupled_csv(summaries), Format::Csv)?;
    }
    if args.csv.as_deref().is_some_and(is_stdout) {
        if let Some(path) = args.output.json.path() {
            write_named(path, &json, Format::Json)?;
        }
        print_exactly(&coupled_csv(summaries))?;
    } else {
        args.output.json.print(|| json.clone(), || results(console, summaries))?;
    }
    let files = if is_final { format!("{ROWS}, {SUITE_ROWS}") } else { SUITE_ROWS.to_owned() };
    console.note(&format!(
        "wrote {}, {files} and {} folders of runs",
        folder.join(REPORT).display(),
        logs.len()
    ));
    let codes: Vec<Exit> = summaries.iter().map(coupled_exit_code).collect();
    Ok(worst(&codes))
}

/// Text of the results: failures, table and notes.
fn results(console: Console, summaries: &[CoupledSummary]) -> String {
    let robots = summaries.iter().flat_map(|summary| summary.robots.values());
    let mut text: String =
        assumed_notes(robots.clone()).iter().map(|note| format!("ASSUMED {note}\n")).collect();
    allowed_notes(robots).iter().for_each(|note| text += &format!("ALLOWED {note}\n"));
    for summary in summaries {
        for failure in summary.failures() {
            text += &format!("FAILED {}: {failure}\n", summary.title());
        }
    }
    text += &render(&coupling_table(summaries));
    with_notes(console, text, &coupling_notes(summaries))
}
