//! Rows of a suite's runs: a file of JSON lines, to which each run is appended when it is complete.
//!
//! The first line identifies the suite, and each other line is a [`SuiteRow`]. A line that was cut off, by the end of the
//! process in the middle of it for example, is ignored when the file is read.

use crate::shard::Shard;
use crate::suite::{MAX_RUNS, Suite};
use opspace_experiment::evaluate::run_summary::RunSummary;
use opspace_experiment::run::result_files::write_file;
use opspace_model::files::open_file;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::Mutex;

/// File name of the rows in a folder of results.
pub const SUITE_ROWS: &str = "rows.jsonl";

/// Formats of a file of rows: of runs with one robot each, and with several.
const OF_ONE_ROBOT: &str = "opspace.rows/1";
const OF_SEVERAL_ROBOTS: &str = "opspace.coupled-rows/1";

/// First line of the file: what has been run, and with what.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SuiteHeader {
    /// Format of the file.
    pub schema: String,
    /// Version of opspace that executed the runs.
    pub opspace_version: String,
    /// [Fingerprint](Suite::fingerprint) of the suite.
    pub suite_sha256: String,
    /// Name of the folder for the results of the whole suite.
    pub name: String,
    /// Subject of the suite.
    pub title: String,
    /// Names of the columns of the suite's table.
    pub columns: Vec<String>,
    /// True if the suite lists the columns.
    pub columns_required: bool,
    /// Number of runs of the whole suite.
    pub runs: usize,
    /// Part of the suite to which the rows are limited; `None` for the whole suite.
    pub shard: Option<Shard>,
}

impl SuiteHeader {
    /// Describes the results of a suite, or of a part of it, by this version of opspace.
    #[must_use]
    pub fn new(suite: &Suite, name: &str, shard: Option<Shard>) -> Self {
        let schema = if suite.has_several_robots() { OF_SEVERAL_ROBOTS } else { OF_ONE_ROBOT };
        Self {
            schema: schema.to_owned(),
            opspace_version: env!("CARGO_PKG_VERSION").to_owned(),
            suite_sha256: suite.fingerprint(),
            name: name.to_owned(),
            title: suite.title.clone(),
            columns: suite.columns.iter().filter_map(|metric| Some(metric.column?.name.to_owned())).collect(),
            columns_required: suite.columns_required,
            runs: suite.runs.len(),
            shard,
        }
    }

    /// Header of the whole suite to which these rows belong.
    #[must_use]
    pub fn of_whole_suite(&self) -> Self {
        Self { shard: None, ..self.clone() }
    }

    /// True if both are about the same suite and the same version of opspace, whatever the part.
    #[must_use]
    pub fn is_of_same_suite(&self, other: &Self) -> bool {
        self.opspace_version == other.opspace_version && self.suite_sha256 == other.suite_sha256
    }

    /// True if the runs have several robots.
    #[must_use]
    pub fn has_several_robots(&self) -> bool {
        self.schema == OF_SEVERAL_ROBOTS
    }

    /// Numbers of the runs, from 1, to which the rows are limited.
    pub fn numbers(&self) -> impl Iterator<Item = usize> + use<> {
        let shard = self.shard;
        (1..=self.runs).filter(move |&number| shard.is_none_or(|shard| shard.contains(number)))
    }
}

/// Results of one run of a suite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct SuiteRow {
    /// Number of the run in the suite, from 1.
    pub run: usize,
    /// File name of its log, or name of the folder with those of several robots; `None` if they are not kept.
    pub log: Option<String>,
    /// Summary of the run.
    pub row: RunSummary,
}

impl SuiteRow {
    /// Creates the row of a run.
    #[must_use]
    pub fn new(run: usize, log: Option<String>, row: RunSummary) -> Self {
        Self { run, log, row }
    }
}

/// Rows of a suite's runs, with their header.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SuiteRows {
    /// Description of the suite and its part.
    pub header: SuiteHeader,
    /// Rows by the number of their run.
    pub rows: BTreeMap<usize, SuiteRow>,
}

impl SuiteRows {
    /// Creates rows without any run.
    #[must_use]
    pub fn new(header: SuiteHeader) -> Self {
        Self { header, rows: BTreeMap::new() }
    }

    /// Reads the rows in a folder of results; `None` if it has none, or none that can be read.
    #[must_use]
    pub fn read(folder: &Path) -> Option<Self> {
        let mut bytes = Vec::new();
        open_file(&folder.join(SUITE_ROWS)).ok()?.read_to_end(&mut bytes).ok()?;
        Self::parse(&bytes)
    }

    /// Parses a file of rows; `None` if its first line is not the header of a suite. Lines that are not complete rows of a run that
    /// the header includes are ignored, as is the second row of a run.
    #[must_use]
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut lines = bytes.split(|&byte| byte == b'\n');
        let header: SuiteHeader = serde_json::from_slice(lines.next()?).ok()?;
        // The numbers of all runs of a suite are listed when some are missing.
        if ![OF_ONE_ROBOT, OF_SEVERAL_ROBOTS].contains(&header.schema.as_str()) || header.runs > MAX_RUNS {
            return None;
        }
        let mut rows = BTreeMap::new();
        let included = |run: usize| {
            (1..=header.runs).contains(&run) && header.shard.is_none_or(|shard| shard.contains(run))
        };
        for row in lines.filter_map(|line| serde_json::from_slice::<SuiteRow>(line).ok()) {
            // A log is a file beside the rows: a path to elsewhere is not one that a suite wrote.
            let beside = row.log.as_ref().is_none_or(|log| Path::new(log).file_name() == Some(log.as_ref()));
            let is_of_kind = row.row.single().is_none() == header.has_several_robots();
            if included(row.run) && beside && is_of_kind {
                rows.entry(row.run).or_insert(row);
            }
        }
        Some(Self { header, rows })
    }

    /// Numbers of the runs, from 1, without a row.
    #[must_use]
    pub fn missing(&self) -> Vec<usize> {
        self.header.numbers().filter(|number| !self.rows.contains_key(number)).collect()
    }

    /// Text of the file, with the rows in the order of the suite.
    #[must_use]
    pub fn text(&self) -> String {
        let rows = self.rows.values().map(line);
        std::iter::once(line(&self.header)).chain(rows).collect()
    }

    /// Replaces the file in a folder of results, and opens it for further rows.
    ///
    /// # Errors
    /// A file that can't be written.
    pub fn append_to(&self, folder: &Path) -> io::Result<SuiteRowsFile> {
        let path = folder.join(SUITE_ROWS);
        write_file(&path, &self.text())?;
        Ok(SuiteRowsFile(Mutex::new(File::options().append(true).open(path)?)))
    }
}

/// Open file of rows, to which several threads append.
#[derive(Debug)]
pub struct SuiteRowsFile(Mutex<File>);

impl SuiteRowsFile {
    /// Appends a row as one complete line and waits until it is on the disk.
    ///
    /// # Errors
    /// A file that can't be written.
    pub fn push(&self, row: &SuiteRow) -> io::Result<()> {
        let mut file = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        file.write_all(line(row).as_bytes())?;
        // Not every file can be synchronised, and the row is written in any case.
        let _ = file.sync_data();
        Ok(())
    }
}

fn line(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default() + "\n"
}

#[cfg(test)]
mod tests {
    use super::{OF_ONE_ROBOT, OF_SEVERAL_ROBOTS, SuiteHeader, SuiteRow, SuiteRows};
    use opspace_experiment::evaluate::summary::Summary;
    use serde_json::{Value, json};

    fn header() -> SuiteHeader {
        SuiteHeader {
            schema: OF_ONE_ROBOT.to_owned(),
            opspace_version: "1".to_owned(),
            suite_sha256: "ab".to_owned(),
            name: "bench-a".to_owned(),
            title: "a".to_owned(),
            columns: Vec::new(),
            columns_required: false,
            runs: 4,
            shard: "1/2".parse().ok(),
        }
    }

    /// Summary with numbers that are hard to print, and one that is missing.
    fn summary() -> Summary {
        let summary: Value = json!({
            "task": "a", "robot": "r", "backend": "torque", "controller": "osc", "profile": "p", "ratio": 5, "seed": 1,
            "simulated": true, "duration_s": 0.1, "overrides": [], "interrupted": false, "rows_lost": 0,
            "not_saved": [], "missed_cycles": 0, "stale_target_cycles": 0, "resumed": 0, "missed_expectations": [],
            "failures": [], "metrics": { "position_rms_m": 1.0e-17, "contact_losses": 3 }, "tasks": {}, "joints": {},
            "timing": { "tick_ns_median": null, "tick_ns_p99": 0.1, "tick_ns_max": 1e300 },
        });
        serde_json::from_value(summary).expect("a summary")
    }

    /// Compared: a file of rows, and the text of what was read from it.
    #[test]
    fn rows_are_read_as_they_were_written() {
        let mut rows = SuiteRows::new(header());
        rows.rows.insert(3, SuiteRow::new(3, Some("a.mcap".to_owned()), summary().into()));
        let text = rows.text();
        let read = SuiteRows::parse(text.as_bytes()).expect("rows");
        assert_eq!(read.text(), text);
        let row = read.rows[&3].row.single().expect("one robot");
        assert!(row.timing.tick_ns_median.is_nan());
        assert_eq!(row.metrics, summary().metrics);
    }

    /// Checks a header of more runs than a suite may have, whose numbers fill the memory.
    #[test]
    fn header_of_too_many_runs_is_refused() {
        let rows = |runs: usize| SuiteRows::new(SuiteHeader { runs, ..header() }).text();
        assert!(SuiteRows::parse(rows(100_000).as_bytes()).is_some());
        for runs in [100_001, usize::MAX] {
            assert_eq!(SuiteRows::parse(rows(runs).as_bytes()), None);
        }
    }

    /// Lines that were cut off or mixed with others, a second row of a run, runs of other shards, and logs elsewhere.
    #[test]
    fn lines_that_are_no_rows_are_ignored() {
        let line = |run: usize, log: Option<&str>, task: &str| {
            let mut summary = summary();
            summary.task = task.to_owned();
            super::line(&SuiteRow::new(run, log.map(str::to_owned), summary.into()))
        };
        let first = line(1, None, "a");
        let mut text = super::line(&header()).into_bytes();
        text.extend(&first.as_bytes()[..20]);
        text.extend(b"\n\xff\xfe\n{}\n");
        for part in [&first, &line(1, None, "b"), &line(2, None, "c"), &line(5, None, "d")] {
            text.extend(part.as_bytes());
        }
        text.extend(line(3, Some("../a.mcap"), "e").as_bytes());
        text.extend(&first.as_bytes()[..first.len() / 2]);
        let rows = SuiteRows::parse(&text).expect("rows").rows;
        assert_eq!(rows.keys().copied().collect::<Vec<_>>(), [1]);
        assert_eq!(rows[&1].row.experiment, "a");
        let several = SuiteHeader { schema: OF_SEVERAL_ROBOTS.to_owned(), ..header() };
        let text = super::line(&several) + &first;
        let rows = SuiteRows::parse(text.as_bytes()).expect("rows").rows;
        assert!(rows.is_empty(), "a row of one robot, among those of several");
        for wrong in ["", "{}", "x", &first] {
            assert_eq!(SuiteRows::parse(wrong.as_bytes()), None, "{wrong}");
        }
    }
}
