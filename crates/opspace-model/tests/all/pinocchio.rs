//! Compares the algorithms with the numbers of Pinocchio on six robots: see `tests/oracles/pinocchio/README.md`. The
//! two programs have no common code: Pinocchio has its own URDF reader, algebra and algorithms.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::oracle::{Oracle, oracle};
use opspace_model::JointKind;
use opspace_model::samples::{Sample, evaluate};
use opspace_testing::oracle::{numbers, relative_error};

/// Largest error of any entry relative to max(1, largest entry of the reference), for quantities computed only by
/// additions and multiplications. Ten times the largest measured error, 5.1e-15.
const TOLERANCE: f64 = 5e-14;
/// Tolerance for quantities that need the inverse of M or J M⁻¹ Jᵀ, with condition numbers up to 1e6. Ten times the
/// largest measured error, 3.7e-11.
const INVERSE_TOLERANCE: f64 = 4e-10;

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

fn every_sample_agrees(robot: &str) {
    let Oracle { meta, samples, model } = oracle(&format!("pinocchio/{robot}.json"));
    let tip = model.frame_id(meta["tip_frame"].as_str().unwrap()).unwrap();
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
    let Oracle { meta, model, .. } = oracle(&format!("pinocchio/{robot}.json"));
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
