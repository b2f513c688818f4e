//! Text of a file that a Python dictionary describes.

use crate::errors::argument;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyString};
use toml::{Table, Value};

/// Deepest nesting; files are flat, so that more is a dictionary that contains itself.
const MAX_DEPTH: usize = 32;

/// Returns the table that a dictionary describes: keys are texts, and values texts, paths, numbers, booleans, dictionaries,
/// and sequences or arrays of these.
///
/// # Errors
/// Other keys or values; the error names the key.
pub(crate) fn table(name: &str, dictionary: &Bound<'_, PyDict>) -> PyResult<Table> {
    table_at(&mut vec![name.to_owned()], dictionary)
}

/// Returns the value of a Python object, as in a TOML file.
///
/// # Errors
/// As [`table`].
pub(crate) fn value(name: &str, object: &Bound<'_, PyAny>) -> PyResult<Value> {
    value_at(&mut vec![name.to_owned()], object)
}

fn table_at(path: &mut Vec<String>, dictionary: &Bound<'_, PyDict>) -> PyResult<Table> {
    let mut table = Table::new();
    for (key, object) in dictionary {
        let Ok(key) = key.extract::<String>() else {
            return Err(argument(&path.join("."), &format!("the key {key} is not a text")));
        };
        path.push(key.clone());
        table.insert(key, value_at(path, &object)?);
        path.pop();
    }
    Ok(table)
}

fn value_at(path: &mut Vec<String>, object: &Bound<'_, PyAny>) -> PyResult<Value> {
    let refuse = |message: &str| argument(&path.join("."), message);
    if path.len() > MAX_DEPTH {
        return Err(refuse("is nested too deeply"));
    }
    if let Ok(dictionary) = object.cast::<PyDict>() {
        return Ok(Value::Table(table_at(path, dictionary)?));
    }
    if object.is_instance_of::<PyString>() {
        return Ok(Value::String(object.extract()?));
    }
    if object.is_instance_of::<PyBool>() {
        return Ok(Value::Boolean(object.extract()?));
    }
    if object.is_instance_of::<PyInt>() {
        let number = object.extract().map_err(|_| refuse("is an integer of more than 64 bits"))?;
        return Ok(Value::Integer(number));
    }
    if object.is_instance_of::<PyFloat>() {
        return Ok(Value::Float(object.extract()?));
    }
    if object.hasattr("__fspath__")? {
        return Ok(Value::String(object.call_method0("__fspath__")?.extract()?));
    }
    // Arrays and scalars of numpy.
    if object.hasattr("tolist")? {
        let plain = object.call_method0("tolist")?;
        if !plain.hasattr("tolist")? {
            return value_at(path, &plain);
        }
    }
    let is_sequence = object.hasattr("__getitem__")? && object.hasattr("__len__")?;
    if !is_sequence {
        let kind = object.get_type().name()?;
        return Err(refuse(&format!("a value of type '{kind}' cannot stand in a file")));
    }
    let mut values = Vec::new();
    for (place, item) in object.try_iter()?.enumerate() {
        path.push(place.to_string());
        values.push(value_at(path, &item?)?);
        path.pop();
    }
    Ok(Value::Array(values))
}
