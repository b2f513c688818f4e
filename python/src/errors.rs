//! Errors as Python sees them: a message, and the place of the mistake as attributes.

use opspace_experiment::{FileError, RunError};
use opspace_log::LogError;
use opspace_loop::Fault;
use opspace_model::Model;
use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::any::Any;
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};

create_exception!(
    opspace,
    OpspaceError,
    PyValueError,
    "Mistake in a file, a dictionary or an argument.\n\nAttributes: file (str), line (int, from 1), key (str, dotted) and \
     code (str) say where and what it is, help (str) how to correct it. Each is None where it does not apply."
);
create_exception!(
    opspace,
    RobotFault,
    PyRuntimeError,
    "Fault that stopped a robot.\n\nAttributes: code (int, as in the channel `tick` of a log), joint (str or None), cause \
     (str) and time_s (float, s since the start of control)."
);

/// Names of the attributes of an [`OpspaceError`].
const OF_ERROR: [&str; 5] = ["file", "line", "key", "help", "code"];

/// Names of the attributes of a [`RobotFault`].
const OF_FAULT: [&str; 4] = ["code", "joint", "cause", "time_s"];

/// Gives both classes attributes that are `None`, for errors that are raised in Python.
pub(crate) fn add_attributes(py: Python<'_>) -> PyResult<()> {
    for (class, names) in
        [(py.get_type::<OpspaceError>(), &OF_ERROR[..]), (py.get_type::<RobotFault>(), &OF_FAULT[..])]
    {
        for name in names {
            class.setattr(*name, py.None())?;
        }
    }
    Ok(())
}

/// Returns an error about an argument: its message begins with the name of the argument, which is the key.
pub(crate) fn argument(name: &str, message: &str) -> PyErr {
    with_attributes(format!("{name}: {message}"), &[("key", Some(name.to_owned()))], None)
}

/// Returns an error without a place.
pub(crate) fn refused(message: impl Into<String>, help: Option<&str>) -> PyErr {
    let text = help.map_or_else(String::new, |help| format!("\nhelp: {help}"));
    with_attributes(message.into() + &text, &[("help", help.map(str::to_owned))], None)
}

/// Returns the error of a file. The text of a dictionary, one of `dictionaries`, has no lines that its user knows: the message
/// names the key instead.
pub(crate) fn of_file(error: &FileError, dictionaries: &[&str]) -> PyErr {
    let is_dictionary = dictionaries.contains(&error.path());
    let key = error.key();
    let mut text = match (&key, is_dictionary) {
        (Some(key), true) => format!("{}: `{key}`: {}", error.path(), error.message()),
        (None, true) => format!("{}: {}", error.path(), error.message()),
        (_, false) => error.to_string(),
    };
    if let Some(help) = error.help() {
        text += "\nhelp: ";
        text += help;
    }
    let attributes = [
        ("file", Some(error.path().to_owned()).filter(|_| !is_dictionary)),
        ("key", key),
        ("help", error.help().map(str::to_owned)),
        ("code", error.code().map(|code| code.to_string())),
    ];
    with_attributes(text, &attributes, error.line().filter(|_| !is_dictionary))
}

/// Returns the error of a run.
pub(crate) fn of_run(error: &RunError, dictionaries: &[&str]) -> PyErr {
    match error {
        RunError::File(error) => of_file(error, dictionaries),
        other => refused(other.to_string(), None),
    }
}

/// Returns the error of the log at `path`.
pub(crate) fn of_log(error: &LogError, path: &str) -> PyErr {
    with_attributes(format!("{path}: {error}"), &[("file", Some(path.to_owned()))], None)
}

/// Returns an error with attributes; those without a value keep the class's `None`.
fn with_attributes(text: String, attributes: &[(&str, Option<String>)], line: Option<usize>) -> PyErr {
    let error = OpspaceError::new_err(text);
    Python::attach(|py| {
        let value = error.value(py);
        let texts = attributes.iter().filter_map(|(name, text)| Some((name, text.as_ref()?)));
        let set = texts.map(|(name, text)| value.setattr(*name, text));
        let set = set.chain(line.map(|line| value.setattr("line", line)));
        set.collect::<PyResult<()>>().err().unwrap_or(error.clone_ref(py))
    })
}

/// Fault of a robot, without Python.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FaultText {
    /// Code as in the log.
    pub code: u32,
    /// Name of the joint, if the fault has one.
    pub joint: Option<String>,
    /// Description with the joint's name and units.
    pub cause: String,
    /// Time since the start of control, s.
    pub time_s: f64,
}

impl FaultText {
    /// Describes a fault of a robot.
    pub(crate) fn new(fault: &Fault, time_s: f64, model: &Model) -> Self {
        let joint = fault.joint().and_then(|joint| model.joints().get(joint));
        let joint = joint.map(|joint| joint.name.clone());
        Self { code: fault.code(), joint, cause: fault.describe(model), time_s }
    }

    /// Returns the exception.
    pub(crate) fn error(&self, py: Python<'_>) -> PyResult<PyErr> {
        let error = RobotFault::new_err(format!("stopped at {:.3} s: {}", self.time_s, self.cause));
        let value = error.value(py);
        value.setattr("code", self.code)?;
        value.setattr("joint", &self.joint)?;
        value.setattr("cause", &self.cause)?;
        value.setattr("time_s", self.time_s)?;
        Ok(error)
    }
}

thread_local! {
    /// First exception of a task or a metric that is written in Python, in this thread.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };
}

/// Keeps an exception that a task or a metric raised inside of a computation, with its traceback, until the computation returns.
pub(crate) fn keep_raised(error: PyErr) {
    RAISED.with_borrow_mut(|raised| {
        raised.get_or_insert(error);
    });
}

/// Takes the exception that was kept in this thread.
pub(crate) fn take_raised() -> Option<PyErr> {
    RAISED.take()
}

/// Calls `body`; a panic in it becomes an error, and so does an exception that was kept.
pub(crate) fn caught<T>(body: impl FnOnce() -> T) -> PyResult<T> {
    let returned = catch_unwind(AssertUnwindSafe(body));
    match take_raised() {
        Some(error) => Err(error),
        None => returned.map_err(|panic| of_panic(&*panic)),
    }
}

/// Returns the error of a panic.
pub(crate) fn of_panic(panic: &(dyn Any + Send)) -> PyErr {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
    let help = "this is a mistake of opspace: please report it with the files that caused it";
    refused(format!("opspace panicked: {text}"), Some(help))
}
