//! Reference values of other programs in `tests/oracles/`, the URDFs to which they belong, and relative errors.

use serde_json::Value;
use std::fs;

const ORACLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/oracles");

/// File of reference values with its URDF.
pub struct Oracle {
    /// Facts about all samples: file, frames and joints of the robot.
    pub meta: Value,
    /// States, each with inputs and reference results.
    pub samples: Vec<Value>,
    /// Path of the URDF.
    pub urdf_path: String,
    /// Text of the URDF.
    pub urdf: String,
}

impl Oracle {
    /// Reads a file of `tests/oracles/`.
    ///
    /// # Panics
    /// If a file is missing or malformed, or if the URDF is not the one for which the values were computed.
    #[must_use]
    pub fn read(file: &str) -> Self {
        let mut numbers: Value = serde_json::from_str(&read(&format!("{ORACLES}/{file}"))).expect(file);
        let (meta, samples) = (numbers["meta"].take(), numbers["samples"].take());
        let urdf_path = format!("{ORACLES}/pinocchio/urdf/{}", meta["urdf"].as_str().expect("urdf"));
        let urdf = read(&urdf_path);
        let digest: String =
            hmac_sha256::Hash::hash(urdf.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(meta["urdf_sha256"], digest.as_str(), "{file}: not the URDF that the numbers are of");
        Self { meta, samples: samples.as_array().expect("a list").clone(), urdf_path, urdf }
    }
}

/// Path of a URDF in `tests/oracles/`, given by its name without extension.
#[must_use]
pub fn urdf_path(robot: &str) -> String {
    format!("{ORACLES}/pinocchio/urdf/{robot}.urdf")
}

/// Text of a URDF in `tests/oracles/`, given by its name without extension.
///
/// # Panics
/// If there is no such file.
#[must_use]
pub fn urdf(robot: &str) -> String {
    read(&urdf_path(robot))
}

/// Converts a JSON number or a list of numbers.
///
/// # Panics
/// If the value is neither.
#[must_use]
pub fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(entries) => entries.iter().map(|x| x.as_f64().expect("a number")).collect(),
        _ => vec![value.as_f64().expect("a number")],
    }
}

/// Largest error of any entry, relative to max(1, largest reference value); NaN if any error is NaN.
///
/// # Panics
/// If the lengths differ.
#[must_use]
pub fn relative_error(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let scale = theirs.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
    // f64::max would ignore a NaN.
    let errors = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs() / scale);
    errors.fold(0.0, |m: f64, e| if e > m || e.is_nan() { e } else { m })
}

fn read(path: &str) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{path}: {e}"))
}
