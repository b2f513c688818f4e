//! Compares the algorithms with the numbers of MuJoCo, with rotors and tilted gravity: see
//! `tests/oracles/mujoco/README.md`. MuJoCo has its own URDF reader and computes by its own recursions in other
//! coordinates.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test")]

use crate::oracle::{Oracle, oracle};
use nalgebra::{DMatrix, Matrix3, Matrix6xX, Vector3};
use opspace_model::{Data, aba, frame_jacobian, frame_placement, update};
use opspace_testing::oracle::{numbers, relative_error};
use serde_json::Value;

/// Largest error of any entry relative to max(1, largest entry of the reference). MuJoCo converts inertias to principal
/// axes and normalizes its quaternions. Ten times the largest measured error, 4.0e-14.
const TOLERANCE: f64 = 4e-13;

fn assert_close<'a>(ours: impl IntoIterator<Item = &'a f64>, theirs: &[f64], what: &str) {
    let ours: Vec<f64> = ours.into_iter().copied().collect();
    let error = relative_error(&ours, theirs);
    assert!(error <= TOLERANCE, "{what}: off by {error:e}");
}

fn check_every_sample(robot: &str) {
    let Oracle { meta, samples, model } = oracle(&format!("mujoco/{robot}.json"));
    let n = model.n();
    // Index of each joint in MuJoCo's order, and the reordering of MuJoCo's vectors to our order.
    let theirs: Vec<&str> = meta["joints"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
    assert_eq!(theirs.len(), n);
    let place: Vec<usize> = model
        .joints()
        .iter()
        .map(|j| theirs.iter().position(|&name| name == j.name).expect(&j.name))
        .collect();
    let ordered = |value: &Value| -> Vec<f64> {
        let values = numbers(value);
        place.iter().map(|&i| values[i]).collect()
    };
    let model = model
        .with_gravity(Vector3::from_vec(numbers(&meta["gravity"])))
        .with_rotor_inertia(&ordered(&meta["rotor_inertia"]));
    let tip = model.frame_id(meta["tip_frame"].as_str().unwrap()).unwrap();
    let mut data = Data::new(&model);
    let mut jacobian = Matrix6xX::zeros(n);

    assert_eq!(samples.len(), 5);
    for sample in &samples {
        assert!(update(&model, &mut data, &ordered(&sample["q"]), &ordered(&sample["dq"])));
        aba(&model, &mut data, &ordered(&sample["tau_in"]));
        frame_jacobian(&model, &data, tip, &mut jacobian);
        let placement = frame_placement(&model, &data, tip);

        let rotation = Matrix3::from_row_slice(&numbers(&sample["tip_R"]));
        assert_close(&placement.rotation, rotation.as_slice(), "tip_R");
        assert_close(&placement.translation, &numbers(&sample["tip_p"]), "tip_p");
        let mass = DMatrix::from_row_slice(n, n, &numbers(&sample["M"]));
        let mass = DMatrix::from_fn(n, n, |i, j| mass[(place[i], place[j])]);
        assert_close(&data.mass_matrix, mass.as_slice(), "M");
        let columns = Matrix6xX::from_row_slice(&numbers(&sample["J"]));
        let columns = Matrix6xX::from_fn(n, |i, j| columns[(i, place[j])]);
        assert_close(&jacobian, columns.as_slice(), "J");
        assert_close(&data.bias, &ordered(&sample["nle"]), "nle");
        assert_close(&data.ddq, &ordered(&sample["ddq_aba"]), "ddq_aba");
    }
}

macro_rules! robots {
    ($($robot:ident),*) => { $(
        #[test]
        fn $robot() {
            check_every_sample(stringify!($robot));
        }
    )* };
}
robots!(double_pendulum, g1_29dof, kinova_j2s6s200, panda, pr2, ur5, xarm7_turned);
