//! The table of metrics: its page, and metrics that a program adds.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::task_metrics::experiment;
use opspace_experiment::evaluate::metrics::JointMetrics;
use opspace_experiment::evaluate::results::table;
use opspace_experiment::metrics::columns::{columns_named, default_columns};
use opspace_experiment::metrics::metric::Column;
use opspace_experiment::{
    Better, Experiment, Extensions, Files, LogMetric, Metric, Metrics, Progress, RunOptions, Summary,
};
use opspace_log::Recording;
use opspace_loop::Phase;
use opspace_suite::Suite;
use std::fmt::Write;
use std::ops::Range;
use std::path::Path;

/// Tables of docs/reference/metrics.md that are generated, each with the name of its place.
fn generated() -> [(&'static str, String); 2] {
    let timing = ["tick_ns_median", "realtime_factor"];
    let rows = Metrics::rows();
    let of_run = rows.iter().filter(|metric| !timing.contains(&metric.key));
    let mut run = "| key | better | column | meaning |\n|---|---|---|---|\n".to_owned();
    for metric in of_run {
        let column = metric.column.map_or_else(String::new, |column| format!("`{}`", column.name));
        let better = match metric.better {
            Better::Neither => "",
            other => other.name(),
        };
        writeln!(run, "| `{}` | {better} | {column} | {} |", metric.key, meaning(metric)).unwrap();
    }
    let mut joints = "| key | meaning |\n|---|---|\n".to_owned();
    for metric in JointMetrics::rows() {
        writeln!(joints, "| `{}` | {} |", metric.key, meaning(&metric)).unwrap();
    }
    [("metrics", run), ("joints", joints)]
}

/// Definition for a page about JSON.
fn meaning(metric: &Metric) -> String {
    metric.meaning.replace("`None`", "`null`")
}

/// Compared: the tables of docs/reference/metrics.md, and those of the rows in the code. `OPSPACE_WRITE_DOCS=1` writes them.
#[test]
fn page_has_the_rows_of_the_table() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference/metrics.md");
    let writes = std::env::var_os("OPSPACE_WRITE_DOCS").is_some();
    let mut page = std::fs::read_to_string(&path).unwrap();
    for (place, text) in generated() {
        let begin = format!("<!-- {place} -->\n");
        let (before, rest) = page.split_once(&begin).expect("a place for the table");
        let (own, after) = rest.split_once("<!-- end -->").expect("an end of the table");
        if writes {
            page = format!("{before}{begin}{text}<!-- end -->{after}");
        } else {
            assert_eq!(own, text, "`{place}` in docs/reference/metrics.md: OPSPACE_WRITE_DOCS=1 writes it");
        }
    }
    if writes {
        std::fs::write(&path, page).unwrap();
    }
}

/// Compared: the keys of a summary, and those of the table; the values by key, and those in the summary.
#[test]
fn table_has_every_key_of_a_summary() {
    let run = experiment("cartesian-tracking", &["duration_s=2.0"]);
    let result = run.run(std::io::Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let log = Recording::from_bytes(result.sink.get_ref()).unwrap();
    let summary = run.summary(&log, &result.record, None);
    let json = serde_json::to_value(&summary).unwrap();
    let own: Vec<&str> = json["metrics"].as_object().unwrap().keys().map(String::as_str).collect();
    let rows = Metrics::rows();
    assert_eq!(own, rows.iter().map(|metric| metric.key).collect::<Vec<_>>());
    for metric in rows {
        assert_eq!(summary.metrics.get(metric.key), json["metrics"][metric.key].as_f64(), "{metric:?}");
    }
    let known = summary.metrics.get("position_rms_m").expect("an error of the position");
    assert_eq!(Some(known), summary.metrics.pose.position_rms_m);
}

/// Highest position of the second joint after settling.
#[derive(Default)]
struct Highest(Option<f64>);

impl LogMetric for Highest {
    fn add(&mut self, segment: &Recording, settled: Range<usize>) {
        let q = segment.tick().expect("a channel").signal("q").expect("positions");
        let values = settled.map(|k| q.row(k)[1]);
        self.0 = values.chain(self.0).reduce(f64::max);
    }

    fn finish(self: Box<Self>) -> Option<f64> {
        self.0
    }
}

fn extensions() -> Extensions {
    let metric = Metric::new("q2_max_rad", Better::Smaller, "Highest position of joint 2, rad.", || {
        Box::new(Highest::default())
    });
    Extensions::default().with(metric.with_column(Column::new("q2-max", "joint 2 max", "mrad", 1e3)))
}

fn task() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cartesian-tracking.toml")
}

fn load(settings: &[&str]) -> Result<Experiment, String> {
    let options = RunOptions { duration_s: Some(2.0), ..RunOptions::default() };
    let settings: Vec<String> = settings.iter().map(|set| (*set).to_owned()).collect();
    Experiment::load_with(&extensions(), Files::Disk, &task(), None, options, &settings)
        .map_err(|error| format!("{error} {}", error.help().unwrap_or_default()))
}

/// Checks a metric whose column has the name of a built-in one: a suite could not tell them apart.
#[test]
fn taken_column_is_refused() {
    let metric = Metric::new("own", Better::Neither, "Own.", || Box::new(Highest::default()));
    let metric = metric.with_column(Column::new("torque-max", "own", "", 1.0));
    let error = extensions().add(metric).unwrap_err().to_string();
    assert_eq!(error, "the metric 'own' already exists, or a name that it brings");
}

/// Compared: an added metric in summary, expectation, table and comparison, and the largest position in the log.
#[test]
fn added_metric_is_one_like_any_other() {
    let experiment = load(&["expect={ q2_max_rad = { at_most = -10.0 } }"]).unwrap();
    let result = experiment.run(std::io::Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let log = Recording::from_bytes(result.sink.get_ref()).unwrap();
    let summary: Summary = experiment.summary(&log, &result.record, None);
    let tick = log.tick().unwrap();
    let (q, phase) = (tick.signal("q").unwrap(), tick.signal("phase").unwrap());
    let control = (0..tick.len()).filter(|&k| phase.row(k)[0] == Phase::Control.code());
    let start_s = tick.time_s[control.clone().next().unwrap()];
    let settle_s = experiment.task().file.settle_s.get();
    let settled = control.filter(|&k| tick.time_s[k] >= start_s + settle_s - 1e-6);
    let expected = settled.map(|k| q.row(k)[1]).reduce(f64::max).unwrap();
    assert_eq!(summary.metrics.get("q2_max_rad"), Some(expected));
    let json = serde_json::to_value(&summary).unwrap();
    assert_eq!(json["metrics"]["q2_max_rad"], expected);
    let read: Summary = serde_json::from_value(json).unwrap();
    assert_eq!(read.metrics, summary.metrics);
    assert_eq!(summary.missed_expectations.len(), 1);

    let extensions = extensions();
    let columns = columns_named(["q2-max"], extensions.added()).unwrap();
    let shown = table(std::slice::from_ref(&summary), &columns);
    assert!(shown.columns.iter().any(|column| column.title == "joint 2 max"));
    assert_eq!(columns_named(["q2-max"], &[]).map(|columns| columns.len()), Err(0));
    assert!(!default_columns(extensions.added()).iter().any(|metric| metric.key == "q2_max_rad"));
}

/// Checks the help for a misspelt name: it has the metrics that the program adds.
#[test]
fn errors_list_the_added_metric() {
    let error = load(&["expect={ q2_max = { at_most = 1.0 } }"]).unwrap_err();
    assert!(error.contains("did you mean 'q2_max_rad'"), "{error}");
    let folder = tempfile::tempdir().unwrap();
    let suite = folder.path().join("suite.toml");
    let text = |column: &str| {
        format!(
            "title = \"t\"\ncolumns = [\"{column}\"]\n[[run]]\ntasks = [{:?}]\n",
            task().display().to_string()
        )
    };
    std::fs::write(&suite, text("q2-mx")).unwrap();
    let error = Suite::load_with(&extensions(), Files::Disk, &suite).unwrap_err();
    assert!(error.help().is_some_and(|help| help.contains("did you mean `q2-max`")), "{error:?}");
    assert_eq!(error.line(), Some(2));
    std::fs::write(&suite, text("q2-max")).unwrap();
    let suite = Suite::load_with(&extensions(), Files::Disk, &suite).unwrap();
    assert_eq!(suite.columns, extensions().added());
}
