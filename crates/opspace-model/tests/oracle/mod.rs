//! Files of foreign numbers: read, matched to the URDF that they are of, and compared with.

use opspace_model::{Model, UrdfOptions};
use serde_json::Value;

pub struct Oracle {
    pub meta: Value,
    pub samples: Vec<Value>,
    pub model: Model,
}

/// `file` of `tests/oracles/`, and the robot that it is about.
pub fn oracle(file: &str) -> Oracle {
    let oracles = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/oracles");
    let read = |path: String| std::fs::read_to_string(&path).expect(&path);
    let mut numbers: Value = serde_json::from_str(&read(format!("{oracles}/{file}"))).expect(file);
    let (meta, samples) = (numbers["meta"].take(), numbers["samples"].take());
    let urdf = read(format!("{oracles}/pinocchio/urdf/{}", meta["urdf"].as_str().expect("urdf")));
    let digest = hmac_sha256::Hash::hash(urdf.as_bytes());
    let digest: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(meta["urdf_sha256"], digest.as_str(), "{file}: not the URDF that the numbers are of");
    let flag = |key: &str| meta[key].as_bool().unwrap_or(false);
    let options = UrdfOptions { floating_base: flag("floating"), fold_mimics: flag("fold_mimics") };
    let model = Model::from_urdf_with(&urdf, options).expect(file).model;
    Oracle { meta, samples: samples.as_array().expect("a list").clone(), model }
}

/// One number, or a list of them.
pub fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(entries) => entries.iter().map(|x| x.as_f64().expect("a number")).collect(),
        _ => vec![value.as_f64().expect("a number")],
    }
}

/// The largest error of any entry relative to max(1, the reference's largest).
pub fn relative_error(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let scale = theirs.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
    // Not f64::max, which would drop a NaN.
    let errors = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs() / scale);
    errors.fold(0.0, |m: f64, e| if e > m || e.is_nan() { e } else { m })
}
