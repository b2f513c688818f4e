//! Kinds of tasks and metrics that are written in Python: entries of the tables of an experiment.

use crate::errors::argument;
use crate::python_metric::metric;
use crate::python_task::task_kind;
use opspace_experiment::Extensions;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

/// Classes by their names, as the constructor of `Experiment` takes them. Clones share them.
#[derive(Clone, Default)]
pub(crate) struct Entries {
    tasks: Option<Arc<Py<PyDict>>>,
    metrics: Option<Arc<Py<PyDict>>>,
}

impl Entries {
    /// Keeps the classes of both dictionaries.
    ///
    /// # Errors
    /// A name that is in use, or an object that is not a class of this kind.
    pub(crate) fn new(
        tasks: Option<&Bound<'_, PyDict>>,
        metrics: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        // What the caller's dictionary becomes later does not count.
        let kept = |entries: Option<&Bound<'_, PyDict>>| {
            entries.map(|entries| Ok::<_, PyErr>(Arc::new(entries.copy()?.unbind()))).transpose()
        };
        let entries = Self { tasks: kept(tasks)?, metrics: kept(metrics)? };
        entries.extensions()?;
        Ok(entries)
    }

    /// Returns the tables with these entries.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub(crate) fn extensions(&self) -> PyResult<Extensions> {
        let mut extensions = Extensions::default();
        Python::attach(|py| {
            for (name, class) in named(py, "tasks", self.tasks.as_deref())? {
                let kind = task_kind(py, name, &class)?;
                extensions.add(kind).map_err(|taken| argument("tasks", &taken.to_string()))?;
            }
            for (key, class) in named(py, "metrics", self.metrics.as_deref())? {
                let metric = metric(py, &key, &class)?;
                extensions.add(metric).map_err(|taken| argument("metrics", &taken.to_string()))?;
            }
            Ok(extensions)
        })
    }

    /// Both dictionaries.
    pub(crate) fn dictionaries<'py>(&self, py: Python<'py>) -> [Option<Bound<'py, PyDict>>; 2] {
        [&self.tasks, &self.metrics].map(|entries| entries.as_ref().map(|entries| entries.bind(py).clone()))
    }
}

/// Names and objects of a dictionary.
fn named(
    py: Python<'_>,
    argument_name: &str,
    entries: Option<&Py<PyDict>>,
) -> PyResult<Vec<(String, Py<PyAny>)>> {
    let Some(entries) = entries else { return Ok(Vec::new()) };
    let entry = |(name, class): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
        let name = name.extract().map_err(|_| argument(argument_name, "a name is not a text"))?;
        if !class.is_callable() {
            return Err(argument(argument_name, &format!("'{name}' is not a class")));
        }
        Ok((name, class.unbind()))
    };
    entries.bind(py).iter().map(entry).collect()
}

/// Returns a name that lives as long as the program. Each name is kept once.
pub(crate) fn for_ever(name: &str) -> &'static str {
    static NAMES: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = names.get(name) {
        return known;
    }
    let kept: &'static str = Box::leak(name.to_owned().into_boxed_str());
    names.insert(kept);
    kept
}
