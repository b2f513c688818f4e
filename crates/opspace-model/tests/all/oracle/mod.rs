//! Robots of the files with reference numbers.

use opspace_model::{Model, UrdfOptions};
use opspace_testing::oracle;
use serde_json::Value;

pub struct Oracle {
    pub meta: Value,
    pub samples: Vec<Value>,
    pub model: Model,
}

/// Reads `file` of `tests/oracles/`, and its robot.
pub fn oracle(file: &str) -> Oracle {
    let oracle::Oracle { meta, samples, urdf, .. } = oracle::Oracle::read(file);
    let flag = |key: &str| meta[key].as_bool().unwrap_or(false);
    let options = UrdfOptions {
        floating_base: flag("floating"),
        enforce_mimic: flag("fold_mimics"),
        ..UrdfOptions::default()
    };
    let model = Model::from_urdf_with(&urdf, options).expect(file).model;
    Oracle { meta, samples, model }
}
