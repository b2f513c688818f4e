//! Metric that is written in Python: a class with `add` and `finish`.

use crate::entries::for_ever;
use crate::errors::{argument, keep_raised};
use crate::log::Log;
use opspace_experiment::{Better, LogMetric, Metric};
use opspace_log::Recording;
use pyo3::prelude::*;
use pyo3::types::PySlice;
use std::ops::Range;
use std::sync::Arc;

/// Returns the metric of a class.
///
/// # Errors
/// A key with other than small letters, digits and underscores; a class without one of the methods; an unknown `better`.
pub(crate) fn metric(py: Python<'_>, key: &str, class: &Py<PyAny>) -> PyResult<Metric> {
    let refuse = |message: &str| argument("metrics", &format!("'{key}' {message}"));
    let is_key = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    if key.is_empty() || !key.chars().all(is_key) {
        return Err(refuse("is not a key: small letters, digits and underscores, with the unit at the end"));
    }
    let of_class = class.bind(py);
    for method in ["add", "finish"] {
        if !of_class.getattr(method).is_ok_and(|method| method.is_callable()) {
            return Err(refuse(&format!("has no method `{method}`")));
        }
    }
    let better = of_class.getattr("better").ok().map(|better| better.extract::<String>());
    let better = match better {
        None => Better::Neither,
        Some(name) => {
            let name = name.unwrap_or_default();
            let known = [Better::Smaller, Better::Larger, Better::Neither];
            let found = known.into_iter().find(|better| better.name() == name);
            found
                .ok_or_else(|| refuse("has a `better` other than \"smaller\", \"larger\" and \"neither\""))?
        }
    };
    let meaning = of_class.getattr("__doc__").and_then(|text| text.extract::<String>()).unwrap_or_default();
    let class = Arc::new(class.clone_ref(py));
    Ok(Metric::new(for_ever(key), better, for_ever(meaning.trim()), move || {
        let object = Python::attach(|py| class.bind(py).call0().map(Bound::unbind));
        Box::new(PythonMetric(object.map_err(keep_raised).ok()))
    }))
}

/// Value of the metric of a run; `None` after an exception, which is kept.
struct PythonMetric(Option<Py<PyAny>>);

impl LogMetric for PythonMetric {
    fn add(&mut self, segment: &Recording, settled: Range<usize>) {
        let Some(object) = &self.0 else { return };
        let added = Python::attach(|py| {
            let settled = PySlice::new(py, settled.start as isize, settled.end as isize, 1);
            object.bind(py).call_method1("add", (Log::new(py, segment.clone())?, settled)).map(|_| ())
        });
        if let Err(error) = added {
            keep_raised(error);
            self.0 = None;
        }
    }

    fn finish(self: Box<Self>) -> Option<f64> {
        let object = self.0?;
        let finished = Python::attach(|py| object.bind(py).call_method0("finish")?.extract::<Option<f64>>());
        finished.map_err(keep_raised).ok().flatten()
    }
}
