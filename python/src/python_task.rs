//! Kind of tasks that is written in Python: a class with `value`, `jacobian` and `bias`.

use crate::arrays::shaped;
use crate::entries::for_ever;
use crate::errors::{argument, keep_raised};
use crate::model::Model;
use nalgebra::{Matrix6xX, Vector6};
use opspace_backend::quantity::Positive;
use opspace_control::{
    ControlError, Coordinate, CoordinateGains, CoordinateTask, Reason, ScalarReference, Task,
};
use opspace_experiment::TaskKind;
use opspace_model::Data;
use pyo3::prelude::*;
use serde::Deserialize;
use std::cell::Cell;
use std::sync::Arc;
use toml::Table;

/// Methods of the class.
const METHODS: [&str; 3] = ["value", "jacobian", "bias"];

/// Table `[task.NAME.KIND]`: what every task of a coordinate has, and the keys of the class.
#[derive(Deserialize)]
struct Parameters {
    /// Feedback of the elements.
    gains: CoordinateGains,
    /// Reference of the first element; absent, it holds its start value.
    reference: Option<ScalarReference>,
    /// References of all elements, in place of `reference`.
    references: Option<Vec<ScalarReference>>,
    /// Highest speed, in the unit of the elements per second; unlimited if absent.
    speed_limit_per_s: Option<Positive>,
    /// All other keys.
    #[serde(flatten)]
    own: Table,
}

/// Returns the kind of tasks of a class.
///
/// # Errors
/// A class without one of the methods.
pub(crate) fn task_kind(py: Python<'_>, name: String, class: &Py<PyAny>) -> PyResult<TaskKind> {
    for method in METHODS {
        if !class.bind(py).getattr(method).is_ok_and(|method| method.is_callable()) {
            return Err(argument("tasks", &format!("the class of '{name}' has no method `{method}`")));
        }
    }
    let (kind, class) = (name.clone(), Arc::new(class.clone_ref(py)));
    Ok(TaskKind::new(name, move |parameters: &Parameters, name, model, _context| {
        let key = format!("task.{name}.{kind}");
        let coordinate = PythonCoordinate::new(&class, parameters, model).map_err(|error| {
            let text = error.to_string();
            keep_raised(error);
            mistake(&key, text)
        })?;
        build(name, &key, parameters, coordinate)
    }))
}

fn mistake(key: &str, message: String) -> ControlError {
    ControlError::new(key, Reason::Value { message })
}

/// Builds the task of a coordinate.
fn build(
    name: &str,
    key: &str,
    parameters: &Parameters,
    coordinate: PythonCoordinate,
) -> Result<Box<dyn Task>, ControlError> {
    let (rows, given) = (coordinate.rows(), &parameters.references);
    let references = match (&parameters.reference, given) {
        (Some(_), Some(_)) => {
            let message = "give either `reference` or `references`".to_owned();
            return Err(mistake(&format!("{key}.references"), message));
        }
        (reference, None) => reference.iter().cloned().collect(),
        (None, Some(references)) if references.len() == rows => references.clone(),
        (None, Some(references)) => {
            let names: Vec<&str> = (0..rows).map(|row| coordinate.element(row).0).collect();
            let (names, given) = (names.join(", "), references.len());
            let message = format!("expected one reference for each of {names}, got {given}");
            return Err(mistake(&format!("{key}.references"), message));
        }
    };
    let task = CoordinateTask::new(name, coordinate, parameters.gains).with_references(references);
    Ok(Box::new(match parameters.speed_limit_per_s {
        Some(limit) => task.with_speed_limit(limit),
        None => task,
    }))
}

/// Coordinate whose methods are those of a Python object. Its first exception is kept, and all values are NaN from then on, which
/// stops the robot.
struct PythonCoordinate {
    object: Py<PyAny>,
    /// Model that the object sees, with the state of the cycle.
    model: Py<Model>,
    elements: Vec<(&'static str, &'static str)>,
    has_difference: bool,
    failed: Cell<bool>,
}

impl PythonCoordinate {
    /// Creates the object of a class, with the keys of the task's table and the model.
    fn new(class: &Py<PyAny>, parameters: &Parameters, model: &opspace_model::Model) -> PyResult<Self> {
        Python::attach(|py| {
            let model = Py::new(py, Model::new(Arc::new(model.clone()), Vec::new(), Vec::new()))?;
            let json = serde_json::to_string(&parameters.own);
            let json = json.map_err(|error| argument("parameters", &error.to_string()))?;
            let own = py.import("json")?.getattr("loads")?.call1((json,))?;
            let object = class.bind(py).call1((own, &model))?;
            let wrong = || {
                argument(
                    "elements",
                    "expected one to six pairs of a name and a unit: [(\"distance\", \"m\")]",
                )
            };
            let elements = object.getattr("elements").map_err(|_| wrong())?;
            let elements: Vec<(String, String)> = elements.extract().map_err(|_| wrong())?;
            if !(1..=6).contains(&elements.len()) {
                return Err(wrong());
            }
            let elements = elements.iter().map(|(name, unit)| (for_ever(name), for_ever(unit))).collect();
            let has_difference = object.hasattr("difference")?;
            Ok(Self { object: object.unbind(), model, elements, has_difference, failed: Cell::new(false) })
        })
    }

    /// Calls a method with the model at the state of `data`; `None` after an exception.
    fn call(&self, method: &str, data: &Data, shapes: &[&[usize]]) -> Option<Vec<f64>> {
        if self.failed.get() {
            return None;
        }
        let called = Python::attach(|py| {
            self.model.get().follow(data);
            let value = self.object.bind(py).call_method1(method, (&self.model,))?;
            shaped(method, &value, shapes)
        });
        self.kept(called)
    }

    /// Keeps an exception.
    fn kept<T>(&self, called: PyResult<T>) -> Option<T> {
        called.map_err(|error| (self.failed.set(true), keep_raised(error))).ok()
    }

    fn vector(&self, method: &str, data: &Data) -> Vector6<f64> {
        let rows = self.elements.len();
        let shapes: [&[usize]; 2] = [&[rows], &[]];
        let values = self.call(method, data, if rows == 1 { &shapes } else { &shapes[..1] });
        let mut vector = Vector6::from_element(f64::NAN);
        if let Some(values) = values {
            vector.as_mut_slice()[..rows].copy_from_slice(&values);
            vector.as_mut_slice()[rows..].fill(0.0);
        }
        vector
    }
}

impl Coordinate for PythonCoordinate {
    fn rows(&self) -> usize {
        self.elements.len()
    }

    fn value(&self, _model: &opspace_model::Model, data: &Data) -> Vector6<f64> {
        self.vector("value", data)
    }

    fn jacobian(&self, model: &opspace_model::Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        let (count, n) = (self.elements.len(), model.n());
        let shapes: [&[usize]; 2] = [&[count, n], &[n]];
        rows.fill(0.0);
        let values = self.call("jacobian", data, if count == 1 { &shapes } else { &shapes[..1] });
        for (place, value) in values.into_iter().flatten().enumerate() {
            rows[(place / n, place % n)] = value;
        }
    }

    fn bias(&self, _model: &opspace_model::Model, data: &Data) -> Vector6<f64> {
        self.vector("bias", data)
    }

    fn difference(&self, row: usize, to: f64, from: f64) -> f64 {
        if !self.has_difference || self.failed.get() {
            return to - from;
        }
        let called = Python::attach(|py| {
            self.object.bind(py).call_method1("difference", (row, to, from))?.extract::<f64>()
        });
        self.kept(called).unwrap_or(f64::NAN)
    }

    fn element(&self, row: usize) -> (&'static str, &'static str) {
        self.elements[row]
    }
}
