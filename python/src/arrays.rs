//! Arrays from Python, converted to 64-bit floats, and checked with errors that name the argument.

use crate::errors::argument;
use numpy::ndarray::ArrayView2;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArrayDyn,
    PyUntypedArrayMethods, ToPyArray,
};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;

/// Kinds of numbers, as numpy names them: floats and integers.
const NUMBERS: &str = "fiu";

/// Kinds of numbers, and booleans.
const NUMBERS_AND_FLAGS: &str = "fiub";

/// Copies `value`, an array or a sequence of `n` numbers of any type, to `out`.
///
/// # Errors
/// Values that are no real numbers, or not `n`.
pub(crate) fn vector(name: &str, value: &Bound<'_, PyAny>, out: &mut [f64]) -> PyResult<()> {
    if let Ok(array) = value.cast::<PyArray1<f64>>() {
        let array: PyReadonlyArray1<'_, f64> = readable(name, array.try_readonly())?;
        let view = array.as_array();
        if view.len() == out.len() {
            out.iter_mut().zip(&view).for_each(|(to, from)| *to = *from);
            return Ok(());
        }
    }
    let array = floats(name, value, NUMBERS)?;
    let view = array.as_array();
    if view.shape() != [out.len()] {
        return Err(argument(name, &format!("expected {} values, got {}", out.len(), shown(view.shape()))));
    }
    out.iter_mut().zip(&view).for_each(|(to, from)| *to = *from);
    Ok(())
}

/// Returns the rows of `value`, an array of shape (N, n), one after the other, and N.
///
/// # Errors
/// Values that are no real numbers, or another shape.
pub(crate) fn rows(name: &str, value: &Bound<'_, PyAny>, n: usize) -> PyResult<(Vec<f64>, usize)> {
    let array = floats(name, value, NUMBERS)?;
    let view = array.as_array();
    match *view.shape() {
        [count, width] if width == n => Ok((view.iter().copied().collect(), count)),
        ref other => {
            Err(argument(name, &format!("expected an array of shape (N, {n}), got {}", shown(other))))
        }
    }
}

/// Returns all numbers and flags of `value`, whatever its shape.
///
/// # Errors
/// Values that are no real numbers.
pub(crate) fn flat(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    Ok(floats(name, value, NUMBERS_AND_FLAGS)?.as_array().iter().copied().collect())
}

/// Returns the numbers of `value`, row by row, which has one of these shapes.
///
/// # Errors
/// Values that are no real numbers, or another shape.
pub(crate) fn shaped(name: &str, value: &Bound<'_, PyAny>, shapes: &[&[usize]]) -> PyResult<Vec<f64>> {
    let array = floats(name, value, NUMBERS)?;
    let view = array.as_array();
    if shapes.contains(&view.shape()) {
        return Ok(view.iter().copied().collect());
    }
    let expected: Vec<String> = shapes.iter().map(|shape| shape_text(shape)).collect();
    let message = format!("expected {}, got {}", expected.join(" or "), shape_text(view.shape()));
    Err(argument(name, &message))
}

/// Describes a shape, also that of a vector.
fn shape_text(shape: &[usize]) -> String {
    match shape {
        [length] => format!("{length} values"),
        shape => shown(shape),
    }
}

/// Converts `value` to an array of 64-bit floats, by numpy.
fn floats<'py>(name: &str, value: &Bound<'py, PyAny>, kinds: &str) -> PyResult<PyReadonlyArrayDyn<'py, f64>> {
    static ASARRAY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let py = value.py();
    let asarray =
        ASARRAY.get_or_try_init(py, || py.import("numpy")?.getattr("asarray").map(Bound::unbind))?;
    let numbers = || argument(name, &format!("expected real numbers, got {}", kind(value)));
    let array = asarray.bind(py).call1((value,)).map_err(|_| numbers())?;
    let is_real = array.getattr("dtype").and_then(|dtype| dtype.getattr("kind"));
    let is_real = is_real.and_then(|kind| kind.extract::<String>()).is_ok_and(|kind| kinds.contains(&kind));
    // An empty list is an array of floats without values.
    if !is_real {
        return Err(numbers());
    }
    let array = asarray.bind(py).call1((array, "float64")).map_err(|_| numbers())?;
    let array = array.cast_into::<PyArrayDyn<f64>>().map_err(|_| numbers())?;
    readable(name, array.try_readonly())
}

/// Returns an array that is being written elsewhere as an error.
fn readable<T, E: std::fmt::Display>(name: &str, array: Result<T, E>) -> PyResult<T> {
    array.map_err(|error| argument(name, &error.to_string()))
}

/// Describes a value that is no array of numbers.
fn kind(value: &Bound<'_, PyAny>) -> String {
    let dtype = value.getattr("dtype").and_then(|dtype| dtype.str().map(|text| text.to_string()));
    let name = || value.get_type().name().map_or_else(|_| "another type".to_owned(), |name| name.to_string());
    dtype.map_or_else(|_| name(), |dtype| format!("an array of {dtype}"))
}

/// Describes a shape: a number of values, or the shape itself.
pub(crate) fn shown(shape: &[usize]) -> String {
    match shape {
        [] => "one number".to_owned(),
        [length] => length.to_string(),
        shape => {
            let sizes: Vec<String> = shape.iter().map(ToString::to_string).collect();
            format!("shape ({})", sizes.join(", "))
        }
    }
}

/// Returns an array (N) that owns the numbers.
pub(crate) fn owned1(py: Python<'_>, numbers: Vec<f64>) -> Bound<'_, PyArray1<f64>> {
    PyArray1::from_vec(py, numbers)
}

/// Returns an array (rows × columns) that owns the numbers, given row by row.
pub(crate) fn owned2(
    py: Python<'_>,
    numbers: Vec<f64>,
    rows: usize,
    columns: usize,
) -> PyResult<Bound<'_, PyArray2<f64>>> {
    PyArray1::from_vec(py, numbers).reshape([rows, columns])
}

/// Returns an array (N × rows × columns) that owns the numbers.
pub(crate) fn owned3(
    py: Python<'_>,
    numbers: Vec<f64>,
    shape: [usize; 3],
) -> PyResult<Bound<'_, PyArray3<f64>>> {
    PyArray1::from_vec(py, numbers).reshape(shape)
}

/// Returns a copy (rows × columns) of numbers given row by row.
pub(crate) fn copied2<'py>(
    py: Python<'py>,
    numbers: &[f64],
    rows: usize,
    columns: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let view = ArrayView2::from_shape((rows, columns), numbers);
    view.map(|view| view.to_pyarray(py)).map_err(|error| argument("array", &error.to_string()))
}

/// Shape of an array that is written to, checked.
///
/// # Errors
/// An array of another shape.
pub(crate) fn check_out(name: &str, array: &Bound<'_, PyArray2<f64>>, shape: [usize; 2]) -> PyResult<()> {
    if array.shape() == shape {
        return Ok(());
    }
    let [rows, columns] = shape;
    Err(argument(
        name,
        &format!("expected an array of shape ({rows}, {columns}), got {}", shown(array.shape())),
    ))
}
