//! Compares the algorithms with the numbers of Pinocchio on six robots: see `tests/oracles/pinocchio/README.md`. The
//! two programs have no common code: Pinocchio has its own URDF reader, algebra and algorithms.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::oracle::{Oracle, oracle};
use nalgebra::{DMatrix, Dim, Matrix, Matrix6xX, RawStorage, Vector3};
use opspace_model::{
    Data, Force, FrameId, JointKind, Model, Motion, OperationalSpace, aba, aba_external, center_of_mass,
    coriolis, frame_bias_acceleration, frame_jacobian, frame_placement, frame_velocity, kinetic_energy,
    potential_energy, rnea, rnea_external, update,
};
use opspace_testing::oracle::{numbers, relative_error};
use serde_json::Value;
use std::collections::BTreeMap;

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
    let rows: Vec<usize> = numbers(&meta["task_rows"]).into_iter().map(|row| row as usize).collect();
    assert_eq!(meta["n_samples"], samples.len());
    for (i, reference) in samples.iter().enumerate() {
        let ours = quantities(&model, tip, reference, &rows);
        for (key, tolerance) in QUANTITIES {
            let error = relative_error(&ours[key], &numbers(&reference[key]));
            assert!(error <= tolerance, "{robot}, sample {i}, {key}: off by {error:e}");
        }
    }
}

/// Computes all quantities of a state, for a task of some rows of the tip's Jacobian.
fn quantities(
    model: &Model,
    tip: FrameId,
    state: &Value,
    rows: &[usize],
) -> BTreeMap<&'static str, Vec<f64>> {
    let [q, dq, ddq, tau, f_tip] = ["q", "dq", "ddq", "tau_in", "f_tip"].map(|key| numbers(&state[key]));
    let (n, k) = (model.n(), rows.len());
    let mut data = Data::new(model);
    assert!(update(model, &mut data, &q, &dq), "M is positive definite");
    coriolis(model, &mut data);
    let mut jacobian = Matrix6xX::zeros(n);
    frame_jacobian(model, &data, tip, &mut jacobian);
    let (force, moment) = f_tip.split_at(3);
    let wrench =
        Force { linear: Vector3::from_column_slice(force), angular: Vector3::from_column_slice(moment) };
    let mut found = BTreeMap::new();
    rnea(model, &mut data, &ddq);
    found.insert("tau_rnea", data.torque.as_slice().to_vec());
    aba(model, &mut data, &tau);
    found.insert("ddq_aba", data.ddq.as_slice().to_vec());
    rnea_external(model, &mut data, &ddq, &[(tip, wrench)]);
    found.insert("tau_rnea_fext", data.torque.as_slice().to_vec());
    aba_external(model, &mut data, &tau, &[(tip, wrench)]);
    found.insert("ddq_aba_fext", data.ddq.as_slice().to_vec());
    let placement = frame_placement(model, &data, tip);
    found.insert("tip_R", row_major(&placement.rotation));
    found.insert("tip_p", placement.translation.as_slice().to_vec());
    found.insert("tip_vel", linear_first(&frame_velocity(model, &data, tip)));
    found.insert("J", row_major(&jacobian));
    found.insert("Jdot_dq", linear_first(&frame_bias_acceleration(model, &data, tip)));
    found.insert("M", row_major(&data.mass_matrix));
    found.insert("g", data.gravity.as_slice().to_vec());
    found.insert("nle", data.bias.as_slice().to_vec());
    found.insert("C", row_major(&data.coriolis_matrix));
    found.insert("com", center_of_mass(model, &data).unwrap().as_slice().to_vec());
    found.insert("kinetic_energy", vec![kinetic_energy(model, &data)]);
    found.insert("potential_energy", vec![potential_energy(model, &data)]);
    let mut task = Matrix6xX::zeros(n);
    rows.iter().enumerate().for_each(|(to, &from)| task.set_row(to, &jacobian.row(from)));
    let (mut space, mut nullspace) = (OperationalSpace::new(n), DMatrix::zeros(n, n));
    space.update(&data.mass_matrix_factor, &task, k, 0.0);
    space.nullspace(&task, &mut nullspace);
    found.insert("Lambda", row_major(&space.task_inertia.view((0, 0), (k, k))));
    found.insert("Jbar", row_major(&space.jbar_transpose.rows(0, k).transpose()));
    found.insert("N", row_major(&nullspace));
    found
}

fn linear_first(motion: &Motion) -> Vec<f64> {
    motion.linear.iter().chain(motion.angular.iter()).copied().collect()
}

fn row_major<R: Dim, C: Dim, S: RawStorage<f64, R, C>>(matrix: &Matrix<f64, R, C, S>) -> Vec<f64> {
    matrix.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<_>>()).collect()
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
