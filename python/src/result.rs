//! Class `Result`: summary, outcome and log of a run.

use crate::entries::Entries;
use crate::errors::{FaultText, caught, of_log, refused};
use crate::experiment::{bytes_of, of_bytes};
use crate::log::Log;
use opspace_experiment::evaluate::headline::headline;
use opspace_experiment::evaluate::results::table;
use opspace_experiment::evaluate::table::Table;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::{Experiment, Summary};
use opspace_log::Recording;
use opspace_report::document::RunSection;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyBytes, PyDict};
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;

/// Log of a run, not read yet.
#[derive(Clone, Debug)]
pub(crate) enum StoredLog {
    /// In memory.
    Bytes(Arc<[u8]>),
    /// In a file.
    Path(PathBuf),
}

impl StoredLog {
    fn read(&self) -> PyResult<Recording> {
        match self {
            Self::Bytes(bytes) => {
                caught(|| Recording::from_bytes(bytes))?.map_err(|error| of_log(&error, "log"))
            }
            Self::Path(path) => {
                caught(|| Recording::read(path))?.map_err(|error| of_log(&error, &path.display().to_string()))
            }
        }
    }
}

/// Summary, outcome and log of a run. In a notebook it shows its table and figures.
#[pyclass(frozen, module = "opspace")]
pub(crate) struct Result {
    experiment: Arc<Experiment>,
    entries: Entries,
    summary: Box<Summary>,
    /// `summary` as in summary.json.
    json: String,
    fault: Option<FaultText>,
    log: StoredLog,
    read: PyOnceLock<Py<Log>>,
}

/// Arguments of [`result_of_parts`]: experiment, summary, fault, bytes of the log, path of the log, tasks, metrics.
type Parts<'py> = (
    Bound<'py, PyBytes>,
    String,
    Option<(u32, Option<String>, String, f64)>,
    Option<Bound<'py, PyBytes>>,
    Option<PathBuf>,
    Option<Bound<'py, PyDict>>,
    Option<Bound<'py, PyDict>>,
);

impl Result {
    /// Creates the result of a run.
    pub(crate) fn new(
        experiment: Arc<Experiment>,
        entries: Entries,
        summary: Summary,
        fault: Option<FaultText>,
        log: StoredLog,
    ) -> PyResult<Self> {
        let json = serde_json::to_string(&summary).map_err(|error| refused(error.to_string(), None))?;
        Ok(Self {
            experiment,
            entries,
            summary: Box::new(summary),
            json,
            fault,
            log,
            read: PyOnceLock::new(),
        })
    }
}

#[pymethods]
impl Result {
    /// Summary of the run: a new dictionary with the keys of summary.json.
    #[getter]
    fn summary<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        py.import("json")?.getattr("loads")?.call1((&self.json,))
    }

    /// The experiment that ran.
    #[getter]
    fn experiment(&self) -> crate::experiment::Experiment {
        crate::experiment::Experiment::of(Arc::clone(&self.experiment), self.entries.clone())
    }

    /// Outcome: "completed", "interrupted" or "faulted".
    #[getter]
    fn outcome(&self) -> &'static str {
        match (&self.summary.faulted, self.summary.interrupted) {
            (Some(_), _) => "faulted",
            (None, true) => "interrupted",
            (None, false) => "completed",
        }
    }

    /// Fault that stopped the robot, an exception that can be raised; None if there was none.
    #[getter]
    fn fault(&self, py: Python<'_>) -> PyResult<Option<PyErr>> {
        self.fault.as_ref().map(|fault| fault.error(py)).transpose()
    }

    /// Log of the run. It is read at the first access.
    #[getter]
    fn log(&self, py: Python<'_>) -> PyResult<Py<Log>> {
        let read = || {
            let recording = py.detach(|| self.log.read())?;
            Py::new(py, Log::new(py, recording)?)
        };
        self.read.get_or_try_init(py, read).map(|log| log.clone_ref(py))
    }

    /// Path of the log; None if it is in memory.
    #[getter]
    fn log_path(&self) -> Option<PathBuf> {
        match &self.log {
            StoredLog::Bytes(_) => None,
            StoredLog::Path(path) => Some(path.clone()),
        }
    }

    /// Figures of the run: pairs of title and SVG.
    fn figures(&self, py: Python<'_>) -> PyResult<Vec<(String, String)>> {
        py.detach(|| {
            let recording = self.log.read()?;
            caught(|| {
                let run = RunSection::new(&self.experiment, &recording, Summary::clone(&self.summary));
                run.figures.iter().map(|figure| (figure.title.clone(), figure.svg())).collect()
            })
        })
    }

    fn _repr_html_(&self, py: Python<'_>) -> PyResult<String> {
        let figures = self.figures(py)?;
        let columns = default_columns(&[]);
        let summaries = [Summary::clone(&self.summary)];
        let table = caught(|| table(&summaries, &columns))?;
        let mut html = format!("<p><b>{}</b></p>\n", escaped(&self.text()));
        html += &html_table(&table);
        for (number, (title, svg)) in figures.into_iter().enumerate() {
            // The first two figures are those that the run is about.
            let open = if number < 2 { " open" } else { "" };
            // Writing to a text cannot fail.
            let _ = write!(
                html,
                "\n<details{open}><summary>{}</summary><div style=\"max-width: 54em; background: white\">{svg}</div></details>",
                escaped(&title)
            );
        }
        Ok(html)
    }

    fn __repr__(&self) -> String {
        format!("Result({})", self.text())
    }

    /// Returns function and arguments that build the result again. A log in a file stays there.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Parts<'py>)> {
        let experiment = PyBytes::new(py, &bytes_of(&self.experiment)?);
        let fault = self.fault.clone().map(|fault| (fault.code, fault.joint, fault.cause, fault.time_s));
        let (bytes, path) = match &self.log {
            StoredLog::Bytes(bytes) => (Some(PyBytes::new(py, bytes)), None),
            StoredLog::Path(path) => (None, Some(path.clone())),
        };
        let build = py.import("opspace._opspace")?.getattr("_result_of_parts")?;
        let [tasks, metrics] = self.entries.dictionaries(py);
        Ok((build, (experiment, self.json.clone(), fault, bytes, path, tasks, metrics)))
    }
}

impl Result {
    /// First lines of the summary, with the outcome.
    fn text(&self) -> String {
        let lines = caught(|| headline(&self.summary)).unwrap_or_default();
        let text = lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ");
        match &self.fault {
            Some(fault) => format!("{text}: {}", fault.cause),
            None => text,
        }
    }
}

/// Builds a pickled result.
#[pyfunction]
#[pyo3(name = "_result_of_parts")]
pub(crate) fn result_of_parts(
    experiment: &[u8],
    summary: String,
    fault: Option<(u32, Option<String>, String, f64)>,
    bytes: Option<&[u8]>,
    path: Option<PathBuf>,
    tasks: Option<&Bound<'_, PyDict>>,
    metrics: Option<&Bound<'_, PyDict>>,
) -> PyResult<Result> {
    let summary: Summary =
        serde_json::from_str(&summary).map_err(|error| refused(error.to_string(), None))?;
    let fault = fault.map(|(code, joint, cause, time_s)| FaultText { code, joint, cause, time_s });
    let log = match (bytes, path) {
        (_, Some(path)) => StoredLog::Path(path),
        (bytes, None) => StoredLog::Bytes(bytes.unwrap_or_default().into()),
    };
    let entries = Entries::new(tasks, metrics)?;
    let experiment = of_bytes(experiment, &entries)?;
    Result::new(Arc::new(experiment), entries, summary, fault, log)
}

/// Table as HTML without style, which the notebook adds.
fn html_table(table: &Table) -> String {
    let mut html = "<table><thead><tr>".to_owned();
    for column in &table.columns {
        let unit = if column.unit.is_empty() { String::new() } else { format!(" [{}]", column.unit) };
        let _ = write!(html, "<th>{}{}</th>", escaped(&column.title), escaped(&unit));
    }
    html += "</tr></thead><tbody>";
    for row in table.texts() {
        html += "<tr>";
        // A row of one cell is a heading of the rows below it.
        let span = if row.len() == 1 { table.columns.len() } else { 1 };
        for text in row {
            let _ = write!(html, "<td colspan=\"{span}\">{}</td>", escaped(&text));
        }
        html += "</tr>";
    }
    html + "</tbody></table>"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
