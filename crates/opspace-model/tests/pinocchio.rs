//! Our algorithms against Pinocchio's numbers on six robots: see `tests/oracles/pinocchio/README.md`.
//! The two share nothing: Pinocchio has its own URDF reader, algebra and algorithms.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test")]

use opspace_model::samples::{Sample, evaluate};
use opspace_model::{JointKind, Model};
use serde_json::Value;
use sha2::{Digest, Sha256};

const DIRECTORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/oracles/pinocchio");

/// Largest error of any entry relative to max(1, largest entry of the reference), where both sides only add
/// and multiply. Measured: below 1e-14.
const TOLERANCE: f64 = 1e-9;
/// The same where M or J M⁻¹ Jᵀ is inverted, of condition up to 1e6.
const INVERSE_TOLERANCE: f64 = 1e-8;

const QUANTITIES: [(&str, f64); 19] = [
    ("tip_R", TOLERANCE),
    ("tip_p", TOLERANCE),
    ("tip_vel", TOLERANCE),
    ("J", TOLERANCE),
    ("Jdot_dq", TOLERANCE),
    ("M", TOLERANCE),
    ("g", TOLERANCE),
    ("nle", TOLERANCE),
    ("C", TOLERANCE),
    ("tau_rnea", TOLERANCE),
    ("ddq_aba", INVERSE_TOLERANCE),
    ("tau_rnea_fext", TOLERANCE),
    ("ddq_aba_fext", INVERSE_TOLERANCE),
    ("com", TOLERANCE),
    ("kinetic_energy", TOLERANCE),
    ("potential_energy", TOLERANCE),
    ("Lambda", INVERSE_TOLERANCE),
    ("Jbar", INVERSE_TOLERANCE),
    ("N", INVERSE_TOLERANCE),
];

struct Oracle {
    meta: Value,
    samples: Vec<Value>,
    model: Model,
}

fn oracle(robot: &str) -> Oracle {
    let read = |path: String| std::fs::read_to_string(&path).expect(&path);
    let mut file: Value = serde_json::from_str(&read(format!("{DIRECTORY}/{robot}.json"))).unwrap();
    let (meta, samples) = (file["meta"].take(), file["samples"].take());
    let urdf = read(format!("{DIRECTORY}/urdf/{}", meta["urdf"].as_str().unwrap()));
    let digest: String = Sha256::digest(&urdf).iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(meta["urdf_sha256"], digest.as_str(), "{robot}: not the URDF that the numbers are of");
    let model = Model::from_urdf(&urdf).expect(robot).model;
    Oracle { meta, samples: samples.as_array().unwrap().clone(), model }
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(entries) => entries.iter().map(|x| x.as_f64().unwrap()).collect(),
        _ => vec![value.as_f64().expect("a number")],
    }
}

fn relative_error(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let scale = theirs.iter().fold(1.0, |m: f64, x| m.max(x.abs()));
    // Not f64::max, which would drop a NaN.
    let errors = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs() / scale);
    errors.fold(0.0, |m: f64, e| if e > m || e.is_nan() { e } else { m })
}

fn every_sample_agrees(robot: &str) {
    let Oracle { meta, samples, model } = oracle(robot);
    let tip = model.frame(meta["tip_frame"].as_str().unwrap()).unwrap();
    assert_eq!(meta["n_samples"], samples.len());
    for (i, reference) in samples.iter().enumerate() {
        let mut input = reference.clone();
        input["task_rows"] = meta["task_rows"].clone();
        let sample: Sample = serde_json::from_value(input).unwrap();
        let ours = serde_json::to_value(evaluate(&model, tip, &sample).unwrap()).unwrap();
        for (key, tolerance) in QUANTITIES {
            let error = relative_error(&numbers(&ours[key]), &numbers(&reference[key]));
            assert!(error <= tolerance, "{robot}, sample {i}, {key}: off by {error:e}");
        }
    }
}

fn joints_agree(robot: &str) {
    let Oracle { meta, model, .. } = oracle(robot);
    let names: Vec<&str> = model.joints().iter().map(|j| j.name.as_str()).collect();
    assert_eq!(meta["joints"], serde_json::json!(names));
    let kinds = model.joints().iter().map(|j| match j.kind {
        JointKind::Revolute => "revolute",
        JointKind::Continuous => "continuous",
        JointKind::Prismatic => "prismatic",
        JointKind::Floating => "floating",
    });
    assert_eq!(meta["joint_types"], serde_json::json!(kinds.collect::<Vec<_>>()));
    let total_mass = numbers(&meta["total_mass"]);
    assert!(relative_error(&[model.total_mass()], &total_mass) < TOLERANCE);
}

macro_rules! robots {
    ($($robot:ident),*) => { $(
        mod $robot {
            #[test]
            fn every_sample_agrees() {
                super::every_sample_agrees(stringify!($robot));
            }

            #[test]
            fn joints_agree() {
                super::joints_agree(stringify!($robot));
            }
        }
    )* };
}
robots!(double_pendulum, g1_29dof, kinova_j2s6s200, panda, panda_arm7, ur5);
