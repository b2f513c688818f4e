//! Compares every algorithm with the numbers of Pinocchio on six robots with 128 states each (the humanoid: 80): see
//! `tests/oracles/pinocchio/README.md`. The robots include a floating base, prismatic joints, a hand with four fingers,
//! a robot with all frames rotated, and one with an enforced mimic joint.
//!
//! Matrices are compared by their product with a vector that is part of the sample.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test")]

use crate::oracle::{Oracle, oracle};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3xX, Matrix6xX, Vector3};
use opspace_model::{
    Data, Force, FrameId, Inertia, Model, aba, aba_derivatives, aba_external, center_of_mass, centroidal_map,
    centroidal_momentum, com_jacobian, coriolis, difference, frame_bias_acceleration, frame_jacobian,
    frame_jacobian_rate, frame_placement, inertial_parameters, integrate, kinetic_energy, local_jacobian,
    local_jacobian_rate, mass_matrix_inverse, neutral, point_jacobian, potential_energy, relative_jacobian,
    rnea, rnea_derivatives, rnea_external, torque_regressor, update, world_jacobian, world_jacobian_rate,
};
use opspace_testing::oracle::{numbers, relative_error};
use serde_json::Value;
use std::collections::BTreeMap;

/// Largest error of any entry relative to max(1, largest entry of the reference), which has ten digits. Ten times the
/// largest measured error, 1.7e-10.
const TOLERANCE: f64 = 1.7e-9;

/// Keys of the inputs of a sample.
const INPUTS: [&str; 7] = ["q", "dq", "ddq", "tau", "wrench_tip", "wrench_second", "x"];

fn triple(value: &Value) -> Vector3<f64> {
    Vector3::from_vec(numbers(value))
}

/// Reads an inertia from the file: in the axes of a link, with moments about the centre of mass.
fn inertia(value: &Value) -> Inertia {
    let [xx, xy, yy, xz, yz, zz] = numbers(&value["inertia"]).try_into().expect("six moments");
    Inertia {
        mass: value["mass"].as_f64().expect("a mass"),
        com: triple(&value["com"]),
        rotational: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
    }
}

fn wrench(value: &Value) -> Force {
    let f = numbers(value);
    Force { linear: Vector3::new(f[0], f[1], f[2]), angular: Vector3::new(f[3], f[4], f[5]) }
}

fn linear_first(linear: &Vector3<f64>, angular: &Vector3<f64>) -> Vec<f64> {
    linear.iter().chain(angular.iter()).copied().collect()
}

fn row_major(rotation: &Matrix3<f64>) -> Vec<f64> {
    rotation.transpose().as_slice().to_vec()
}

/// The robot, its frames, and the random values that all its states share.
struct Bench {
    model: Model,
    tip: FrameId,
    second: FrameId,
    point: Vector3<f64>,
    /// Inertial parameters of all bodies, stacked.
    parameters: DVector<f64>,
    loaded: Model,
    reduced: Model,
    /// Joints that remain in `reduced`.
    left: Vec<usize>,
}

impl Bench {
    fn new(meta: &Value, model: Model) -> Self {
        let frame = |key: &str| model.frame_id(meta[key].as_str().expect(key)).expect(key);
        let mut parameters = DVector::zeros(10 * model.bodies().len());
        for entry in meta["random_inertias"].as_array().expect("a list") {
            let link = model.frame(model.frame_id(entry["link"].as_str().unwrap()).unwrap());
            let body = link.body.expect("moves");
            let theirs = inertial_parameters(&link.placement.act_inertia(&inertia(entry)));
            parameters.as_mut_slice()[10 * body..][..10].copy_from_slice(&theirs);
        }
        let mut loaded = model.clone();
        loaded.set_payload(frame("tip_frame"), inertia(&meta["payload"]));
        let locked: Vec<(usize, f64)> = (meta["locked"].as_array().unwrap().iter())
            .map(|entry| (model.joint(entry[0].as_str().unwrap()).unwrap(), entry[1].as_f64().unwrap()))
            .collect();
        let left = (0..model.n()).filter(|i| locked.iter().all(|(joint, _)| joint != i)).collect();
        Self {
            tip: frame("tip_frame"),
            second: frame("second_frame"),
            point: triple(&meta["point"]),
            parameters,
            loaded,
            reduced: model.with_locked_joints(&locked).unwrap(),
            left,
            model,
        }
    }

    /// Computes all compared quantities of a state.
    fn evaluate(&self, sample: &Value) -> BTreeMap<&'static str, Vec<f64>> {
        let Self { model, tip, second, .. } = self;
        let (tip, second) = (*tip, *second);
        let (q, dq) = (numbers(&sample["q"]), numbers(&sample["dq"]));
        let (ddq, tau) = (numbers(&sample["ddq"]), numbers(&sample["tau"]));
        let x = DVector::from_vec(numbers(&sample["x"]));
        let wrenches = [(tip, wrench(&sample["wrench_tip"])), (second, wrench(&sample["wrench_second"]))];
        let mut out = BTreeMap::new();
        let mut data = Data::new(model);
        assert!(update(model, &mut data, &q, &dq), "M is positive definite");

        let (at_tip, at_second) = (frame_placement(model, &data, tip), frame_placement(model, &data, second));
        out.insert("tip_R", row_major(&at_tip.rotation));
        out.insert("tip_p", at_tip.translation.as_slice().to_vec());
        out.insert("second_R", row_major(&at_second.rotation));
        out.insert("second_p", at_second.translation.as_slice().to_vec());
        let bias = frame_bias_acceleration(model, &data, tip);
        out.insert("Jdot_dq", linear_first(&bias.linear, &bias.angular));

        let mut j = Matrix6xX::zeros(model.n());
        let mut product = |key, fill: &dyn Fn(&mut Matrix6xX<f64>)| {
            fill(&mut j);
            out.insert(key, (&j * &x).as_slice().to_vec());
        };
        product("J_aligned_x", &|j| frame_jacobian(model, &data, tip, j));
        product("J_local_x", &|j| local_jacobian(model, &data, tip, j));
        product("J_world_x", &|j| world_jacobian(model, &data, tip, j));
        product("Jdot_aligned_x", &|j| frame_jacobian_rate(model, &data, tip, j));
        product("Jdot_local_x", &|j| local_jacobian_rate(model, &data, tip, j));
        product("Jdot_world_x", &|j| world_jacobian_rate(model, &data, tip, j));
        product("J_point_x", &|j| point_jacobian(model, &data, tip, &self.point, j));
        product("J_relative_x", &|j| relative_jacobian(model, &data, tip, second, j));
        let mut j_com = Matrix3xX::zeros(model.n());
        com_jacobian(model, &mut data, &mut j_com);
        out.insert("J_com_x", (&j_com * &x).as_slice().to_vec());
        out.insert("com", center_of_mass(model, &data).expect("has mass").as_slice().to_vec());
        out.insert("kinetic_energy", vec![kinetic_energy(model, &data)]);
        out.insert("potential_energy", vec![potential_energy(model, &data)]);

        let vector = |v: &DVector<f64>| v.as_slice().to_vec();
        let times_x = |m: &DMatrix<f64>| (m * &x).as_slice().to_vec();
        out.insert("M_x", times_x(&data.mass_matrix));
        mass_matrix_inverse(&mut data);
        out.insert("Minv_x", times_x(&data.mass_matrix_inverse));
        coriolis(model, &mut data);
        out.insert("C_x", times_x(&data.coriolis_matrix));
        out.insert("g", vector(&data.gravity));
        out.insert("nle", vector(&data.bias));
        rnea(model, &mut data, &ddq);
        out.insert("tau_rnea", vector(&data.torque));
        rnea_external(model, &mut data, &ddq, &wrenches);
        out.insert("tau_rnea_ext", vector(&data.torque));
        centroidal_map(model, &mut data);
        out.insert("Ag_x", (&data.centroidal_map * &x).as_slice().to_vec());
        let momentum = centroidal_momentum(model, &data);
        out.insert("hg", linear_first(&momentum.linear, &momentum.angular));
        let mut regressor = DMatrix::zeros(model.n(), self.parameters.len());
        torque_regressor(model, &mut data, &ddq, &mut regressor);
        out.insert("regressor_tau", vector(&(regressor * &self.parameters)));
        rnea_derivatives(model, &mut data, &ddq);
        out.insert("dtau_dq_x", times_x(&data.torque_by_q));
        out.insert("dtau_dv_x", times_x(&data.torque_by_dq));
        aba(model, &mut data, &tau);
        out.insert("ddq_aba", vector(&data.ddq));
        aba_external(model, &mut data, &tau, &wrenches);
        out.insert("ddq_aba_ext", vector(&data.ddq));
        aba_derivatives(model, &mut data, &tau);
        out.insert("ddq_dq_x", times_x(&data.ddq_by_q));
        out.insert("ddq_dv_x", times_x(&data.ddq_by_dq));

        let mut q_plus = vec![0.0; model.nq()];
        integrate(model, &q, x.as_slice(), &mut q_plus);
        out.insert("q_plus", q_plus);
        let mut from_neutral = vec![0.0; model.n()];
        difference(model, &neutral(model), &q, &mut from_neutral);
        out.insert("from_neutral", from_neutral);

        let mut data = Data::new(&self.loaded);
        assert!(update(&self.loaded, &mut data, &q, &dq));
        out.insert("payload_M_x", times_x(&data.mass_matrix));
        out.insert("payload_nle", vector(&data.bias));

        let pick = |values: &[f64]| -> Vec<f64> { self.left.iter().map(|&i| values[i]).collect() };
        // A quaternion has one entry more than the angular velocity.
        let ahead = model.nq() - model.n();
        let joints_q = pick(&q[ahead..]);
        let reduced_q: Vec<f64> = q[..ahead].iter().copied().chain(joints_q).collect();
        let mut data = Data::new(&self.reduced);
        assert!(update(&self.reduced, &mut data, &reduced_q, &pick(&dq)));
        out.insert("reduced_M_x", vector(&(&data.mass_matrix * DVector::from_vec(pick(x.as_slice())))));
        out.insert("reduced_nle", vector(&data.bias));
        out
    }
}

/// Compares every key of every sample, and checks that each computed quantity is in the file.
fn check_every_state(robot: &str) {
    let Oracle { meta, samples, model } = oracle(&format!("pinocchio/states/{robot}.json"));
    assert!(samples.len() >= 80, "{robot}");
    assert_eq!((meta["nq"].as_u64(), meta["nv"].as_u64()), (Some(model.nq() as u64), Some(model.n() as u64)));
    let base = if model.is_floating() { 6 } else { 0 };
    let names: Vec<&str> = model.joints()[base..].iter().map(|j| j.name.as_str()).collect();
    assert_eq!(meta["joints"], serde_json::json!(names), "{robot}");
    assert!(relative_error(&[model.total_mass()], &numbers(&meta["total_mass"])) < TOLERANCE);
    let bench = Bench::new(&meta, model);
    for (i, sample) in samples.iter().enumerate() {
        let ours = bench.evaluate(sample);
        for key in sample.as_object().unwrap().keys() {
            let known = INPUTS.contains(&key.as_str());
            assert!(known || ours.contains_key(key.as_str()), "{robot}: nobody compares {key}");
        }
        for (key, ours) in ours {
            let error = relative_error(&ours, &numbers(&sample[key]));
            assert!(error <= TOLERANCE, "{robot}, sample {i}, {key}: off by {error:e}");
        }
    }
}

#[test]
fn floating_base_matches_pinocchio() {
    check_every_state("anymal_c");
}

#[test]
fn four_finger_hand_matches_pinocchio() {
    check_every_state("allegro_right_hand");
}

#[test]
fn prismatic_joints_match_pinocchio() {
    check_every_state("pr2");
}

#[test]
fn rotated_frames_and_inertias_match_pinocchio() {
    check_every_state("xarm7_turned");
}

#[test]
fn humanoid_matches_pinocchio() {
    check_every_state("g1_29dof");
}

#[test]
fn mimic_joint_matches_pinocchio() {
    check_every_state("panda");
}
