//! Logs: classes `Log`, `Channel` and `Replay`.

use crate::arrays::{owned1, owned2};
use crate::entries::Entries;
use crate::errors::{caught, of_log, of_run, refused};
use numpy::{PyArray1, PyArray2};
use opspace_experiment::Experiment;
use opspace_experiment::run::replay::replay_log;
use opspace_log::{ChannelData, LogFile, Recording};
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PySlice};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Log of a run.
///
/// `log["tick"]["q"]` is the signal `q` of the channel `tick`. The package's page "The log" lists channels and signals.
#[pyclass(frozen, mapping, module = "opspace")]
pub(crate) struct Log {
    channels: Vec<(String, Py<Channel>)>,
    attachments: Vec<(String, Vec<u8>)>,
    /// Named tables of texts: settings, versions, outcome.
    #[pyo3(get)]
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Description of the damage of the file; None for an intact one.
    #[pyo3(get)]
    damage: Option<String>,
    /// True if the run has closed the file.
    #[pyo3(get)]
    closed: bool,
    /// Number of rows that were lost before they were written.
    #[pyo3(get)]
    dropped: u64,
}

impl Log {
    /// Moves a recording to arrays of numpy, without a copy of the rows.
    pub(crate) fn new(py: Python<'_>, recording: Recording) -> PyResult<Self> {
        let dropped = recording.dropped();
        let channels = recording
            .channels
            .into_iter()
            .map(|data| Ok((data.layout.channel.clone(), Py::new(py, Channel::new(py, data)?)?)));
        Ok(Self {
            channels: channels.collect::<PyResult<_>>()?,
            attachments: recording.attachments.into_iter().map(|file| (file.name, file.data)).collect(),
            metadata: recording.metadata.into_iter().collect(),
            damage: recording.damage.map(|damage| damage.to_string()),
            closed: recording.closed,
            dropped,
        })
    }
}

#[pymethods]
impl Log {
    /// Channels by name.
    #[getter]
    fn channels(&self, py: Python<'_>) -> BTreeMap<String, Py<Channel>> {
        self.channels.iter().map(|(name, channel)| (name.clone(), channel.clone_ref(py))).collect()
    }

    /// Files in the log by name, as bytes: the task, the robot and its URDF, with all settings applied.
    #[getter]
    fn attachments<'py>(&self, py: Python<'py>) -> BTreeMap<String, Bound<'py, PyBytes>> {
        self.attachments.iter().map(|(name, data)| (name.clone(), PyBytes::new(py, data))).collect()
    }

    /// Returns a channel. Raises KeyError, with the names of the channels.
    fn __getitem__(&self, py: Python<'_>, name: &str) -> PyResult<Py<Channel>> {
        let found = self.channels.iter().find(|(channel, _)| channel == name);
        found.map(|(_, channel)| channel.clone_ref(py)).ok_or_else(|| {
            let names: Vec<&str> = self.channels.iter().map(|(name, _)| name.as_str()).collect();
            PyKeyError::new_err(format!("no channel '{name}'; there are: {}", names.join(", ")))
        })
    }

    fn __contains__(&self, name: &str) -> bool {
        self.channels.iter().any(|(channel, _)| channel == name)
    }

    fn __len__(&self) -> usize {
        self.channels.len()
    }

    fn __iter__(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let names: Vec<&str> = self.channels.iter().map(|(name, _)| name.as_str()).collect();
        names.into_pyobject(py)?.call_method0("__iter__").map(Bound::unbind)
    }

    /// Returns a channel as a `pandas.DataFrame`, with the time, s, as its index.
    #[pyo3(signature = (channel="tick"))]
    fn to_pandas<'py>(&self, py: Python<'py>, channel: &str) -> PyResult<Bound<'py, PyAny>> {
        self.__getitem__(py, channel)?.get().to_pandas(py)
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let sizes =
            self.channels.iter().map(|(name, channel)| format!("{name}: {} rows", channel.get().len(py)));
        format!("Log({})", sizes.collect::<Vec<_>>().join(", "))
    }
}

/// Signal of a channel: its columns.
struct Column {
    name: String,
    elements: Vec<String>,
    units: Vec<String>,
    first: usize,
}

/// Rows of a log: T rows of all signals.
///
/// `channel["q"]` is one signal, (T, elements), or (T,) if it has a single value. It is a view of `rows`: a slice, not a copy.
#[pyclass(frozen, mapping, module = "opspace")]
pub(crate) struct Channel {
    /// Name of the channel.
    #[pyo3(get)]
    name: String,
    /// Times on the robot's clock (T), s.
    #[pyo3(get)]
    time_s: Py<PyArray1<f64>>,
    /// All signals (T, width), one after the other. NaN where a signal does not apply.
    #[pyo3(get)]
    rows: Py<PyArray2<f64>>,
    columns: Vec<Column>,
}

impl Channel {
    fn new(py: Python<'_>, data: ChannelData) -> PyResult<Self> {
        let (count, width) = (data.len(), data.layout.width());
        let mut first = 0;
        let columns = data.layout.signals.into_iter().map(|signal| {
            let column = Column { first, name: signal.name, elements: signal.elements, units: signal.units };
            first += column.elements.len();
            column
        });
        let columns = columns.collect();
        Ok(Self {
            name: data.layout.channel,
            time_s: owned1(py, data.time_s).unbind(),
            rows: owned2(py, data.rows, count, width)?.unbind(),
            columns,
        })
    }

    fn len(&self, py: Python<'_>) -> usize {
        self.time_s.bind(py).len().unwrap_or(0)
    }

    fn column(&self, name: &str) -> PyResult<&Column> {
        self.columns.iter().find(|column| column.name == name).ok_or_else(|| {
            let names: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
            PyKeyError::new_err(format!(
                "no signal '{name}' in '{}'; there are: {}",
                self.name,
                names.join(", ")
            ))
        })
    }
}

#[pymethods]
impl Channel {
    /// Names of the signals.
    #[getter]
    fn signals(&self) -> Vec<&str> {
        self.columns.iter().map(|column| column.name.as_str()).collect()
    }

    /// Names of the columns of `rows`: `q.elbow`, or `phase` for a signal of one value.
    #[getter]
    fn columns(&self) -> Vec<String> {
        let of = |column: &Column| match column.elements.as_slice() {
            [only] if only == "value" => vec![column.name.clone()],
            elements => elements.iter().map(|element| format!("{}.{element}", column.name)).collect(),
        };
        self.columns.iter().flat_map(of).collect()
    }

    /// SI units of the columns of a signal: `rad`, `Nm`, `1`.
    fn units(&self, signal: &str) -> PyResult<Vec<String>> {
        Ok(self.column(signal)?.units.clone())
    }

    /// Names of the columns of a signal: joints or axes.
    fn elements(&self, signal: &str) -> PyResult<Vec<String>> {
        Ok(self.column(signal)?.elements.clone())
    }

    /// Returns a signal. Raises KeyError, with the names of the signals.
    fn __getitem__<'py>(&self, py: Python<'py>, signal: &str) -> PyResult<Bound<'py, PyAny>> {
        let column = self.column(signal)?;
        let (first, width) = (column.first, column.elements.len());
        let rows = self.rows.bind(py);
        if column.elements == ["value"] {
            return rows.get_item((PySlice::full(py), first));
        }
        rows.get_item((PySlice::full(py), PySlice::new(py, first as isize, (first + width) as isize, 1)))
    }

    fn __contains__(&self, signal: &str) -> bool {
        self.columns.iter().any(|column| column.name == signal)
    }

    fn __len__(&self) -> usize {
        self.columns.len()
    }

    fn __iter__(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        self.signals().into_pyobject(py)?.call_method0("__iter__").map(Bound::unbind)
    }

    /// Returns all rows as a `pandas.DataFrame`, with the time, s, as its index.
    fn to_pandas<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let pandas = py.import("pandas")?;
        let index = pandas.getattr("Index")?.call(
            (self.time_s.bind(py),),
            Some(&{
                let name = PyDict::new(py);
                name.set_item("name", "time_s")?;
                name
            }),
        )?;
        let options = PyDict::new(py);
        options.set_item("index", index)?;
        options.set_item("columns", self.columns())?;
        options.set_item("copy", false)?;
        pandas.getattr("DataFrame")?.call((self.rows.bind(py),), Some(&options))
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Channel('{}', {} rows, {} signals)", self.name, self.len(py), self.columns.len())
    }
}

/// Reads a log, or its intact part if it is damaged: `Log.damage` then says what is.
///
/// Raises OpspaceError for a file that is not a log of opspace.
#[pyfunction]
pub(crate) fn read_log(py: Python<'_>, path: PathBuf) -> PyResult<Log> {
    let read = py.detach(|| caught(|| Recording::read(&path)))?;
    Log::new(py, read.map_err(|error| of_log(&error, &path.display().to_string()))?)
}

/// Comparison of a log with its recomputation.
#[pyclass(frozen, get_all, module = "opspace")]
pub(crate) struct Replay {
    /// True if each number of each cycle is the same, bit for bit.
    equal: bool,
    /// Number of cycles that were compared.
    compared: usize,
    /// Number of cycles in the log.
    logged: usize,
    /// Number of cycles that differ.
    differing: u64,
    /// Description of the first number that differs; None if all are equal.
    first_difference: Option<String>,
}

#[pymethods]
impl Replay {
    fn __bool__(&self) -> bool {
        self.equal
    }

    fn __repr__(&self) -> String {
        let first =
            self.first_difference.as_ref().map_or_else(String::new, |text| format!(", first: {text}"));
        format!(
            "Replay({} of {} cycles compared, {} differ{first})",
            self.compared, self.logged, self.differing
        )
    }
}

/// Recomputes each cycle of a log from its inputs, and compares all numbers with those of the log.
///
/// tasks: classes of the tasks of the log that are written in Python, as of `Experiment`.
///
/// Raises OpspaceError for a file that is not a log of a run, or of another version.
#[pyfunction]
#[pyo3(signature = (path, *, tasks=None))]
pub(crate) fn replay(py: Python<'_>, path: PathBuf, tasks: Option<&Bound<'_, PyDict>>) -> PyResult<Replay> {
    let (shown, entries) = (path.display().to_string(), Entries::new(tasks, None)?);
    let replayed = py.detach(|| {
        caught(|| {
            let extensions = entries.extensions()?;
            let read = || {
                let log = LogFile::open(&path)?;
                replay_log(&Experiment::of_log_with(&extensions, log.recording())?, &log)
            };
            Ok::<_, PyErr>(read())
        })
    })??;
    let report = replayed.map_err(|error| match error {
        opspace_experiment::RunError::Log(error) => of_log(&error, &shown),
        other => of_run(&other, &[]),
    })?;
    if report.logged == 0 {
        return Err(refused(format!("{shown}: the log has no control cycle"), None));
    }
    let unmatched =
        (!report.unmatched.is_empty()).then(|| format!("signals: {}", report.unmatched.join(", ")));
    let first = report.first_difference.map(|difference| {
        format!("{}.{} at {:.4} s", difference.signal, difference.element, difference.time_s)
    });
    Ok(Replay {
        equal: report.differing == 0 && unmatched.is_none() && report.compared == report.logged,
        compared: report.compared,
        logged: report.logged,
        differing: report.differing,
        first_difference: first.or(unmatched),
    })
}
