//! Numbers of foreign programs in `tests/oracles/`, the URDFs that they are of, and the error relative to them.

use serde_json::Value;
use std::fs;

const ORACLES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/oracles");

/// A file of numbers, matched to its URDF.
pub struct Oracle {
    /// Facts that hold for all samples: the robot's file, its frames, its joints.
    pub meta: Value,
    /// States, each with inputs and the foreign results.
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
    /// If a file is missing or malformed, or the URDF is another one than the numbers are of.
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

/// Path of a URDF of `tests/oracles/`, named without its extension.
#[must_use]
pub fn urdf_path(robot: &str) -> String {
    format!("{ORACLES}/pinocchio/urdf/{robot}.urdf")
}

/// Text of a URDF of `tests/oracles/`, named without its extension.
///
/// # Panics
/// If there is no such file.
#[must_use]
pub fn urdf(robot: &str) -> String {
    read(&urdf_path(robot))
}

/// One number, or a list of them.
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

/// Largest error of any entry relative to max(1, the reference's largest); NaN if an error is none.
///
/// # Panics
/// If the lengths differ.
#[must_use]
pub fn relative_error(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let scale = theirs.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
    // Not f64::max, which would drop a NaN.
    let errors = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs() / scale);
    errors.fold(0.0, |m: f64, e| if e > m || e.is_nan() { e } else { m })
}

fn read(path: &str) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{path}: {e}"))
}
