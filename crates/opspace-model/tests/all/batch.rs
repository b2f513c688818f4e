//! Compares every algorithm on four states at once with the same algorithm on each single state, on random trees with a
//! fixed or floating base and with mimic joints.

use crate::common::{Case, ROUNDING, case, close, config, plus, wrench};
use nalgebra::{DMatrix, Matrix3xX, Matrix6xX, Vector3};
use opspace_model::batch::{self, Lanes};
use opspace_model::{
    Data, Force, FrameId, Model, Motion, Real, aba, aba_derivatives, aba_external, bias, center_of_mass,
    centroidal_map, centroidal_momentum, cholesky, com_jacobian, coriolis, crba, forward_kinematics,
    frame_bias_acceleration, frame_jacobian, frame_jacobian_rate, frame_placement, frame_velocity, gravity,
    kinematics, kinetic_energy, local_jacobian, local_jacobian_rate, mass_matrix_inverse, point_jacobian,
    potential_energy, relative_jacobian, rnea, rnea_derivatives, rnea_external, torque_regressor, update,
    world_jacobian, world_jacobian_rate,
};
use proptest::prelude::*;

/// A state with the torques and the wrench that act in it.
struct State<T> {
    q: Vec<T>,
    dq: Vec<T>,
    ddq: Vec<T>,
    tau: Vec<T>,
    wrench: Force<T>,
}

/// Results of the algorithms for one state, with their names.
type Results<T> = Vec<(&'static str, Vec<T>)>;

fn stacked<T: Real>(linear: &Vector3<T>, angular: &Vector3<T>) -> Vec<T> {
    linear.iter().chain(angular).copied().collect()
}

/// Evaluates all kinematic algorithms.
fn motions<T: Real>(model: &Model<T>, [tip, second]: [FrameId; 2], state: &State<T>, out: &mut Results<T>) {
    let mut data = Data::new(model);
    forward_kinematics(model, &mut data, &state.q);
    let place = frame_placement(model, &data, tip);
    out.push(("placement", place.rotation.iter().chain(&place.translation).copied().collect()));
    kinematics(model, &mut data, &state.q, &state.dq);
    let pair = |m: Motion<T>| stacked(&m.linear, &m.angular);
    out.push(("velocity", pair(frame_velocity(model, &data, tip))));
    out.push(("bias acceleration", pair(frame_bias_acceleration(model, &data, tip))));
    let mut j = Matrix6xX::zeros(model.n());
    let point = Vector3::new(0.1, -0.2, 0.3).map(T::splat);
    let mut filled = |name, fill: &dyn Fn(&mut Matrix6xX<T>)| {
        fill(&mut j);
        out.push((name, j.as_slice().to_vec()));
    };
    filled("aligned Jacobian", &|j| frame_jacobian(model, &data, tip, j));
    filled("local Jacobian", &|j| local_jacobian(model, &data, tip, j));
    filled("world Jacobian", &|j| world_jacobian(model, &data, tip, j));
    filled("point Jacobian", &|j| point_jacobian(model, &data, tip, &point, j));
    filled("relative Jacobian", &|j| relative_jacobian(model, &data, second, tip, j));
    filled("aligned rate", &|j| frame_jacobian_rate(model, &data, tip, j));
    filled("local rate", &|j| local_jacobian_rate(model, &data, tip, j));
    filled("world rate", &|j| world_jacobian_rate(model, &data, tip, j));
    let mut j = Matrix3xX::zeros(model.n());
    com_jacobian(model, &mut data, &mut j);
    out.push(("com Jacobian", j.as_slice().to_vec()));
    out.push(("com", center_of_mass(model, &data).expect("has mass").as_slice().to_vec()));
    out.push(("energies", vec![kinetic_energy(model, &data), potential_energy(model, &data)]));
    centroidal_map(model, &mut data);
    out.push(("centroidal map", data.centroidal_map.as_slice().to_vec()));
    let momentum = centroidal_momentum(model, &data);
    out.push(("momentum", stacked(&momentum.linear, &momentum.angular)));
}

/// Evaluates all dynamic algorithms.
fn dynamics<T: Real>(model: &Model<T>, [tip, second]: [FrameId; 2], state: &State<T>, out: &mut Results<T>) {
    let mut data = Data::new(model);
    kinematics(model, &mut data, &state.q, &state.dq);
    crba(model, &mut data);
    out.push(("mass matrix", data.mass_matrix.as_slice().to_vec()));
    bias(model, &mut data);
    out.push(("bias", data.bias.as_slice().to_vec()));
    gravity(model, &mut data);
    out.push(("gravity", data.gravity.as_slice().to_vec()));
    coriolis(model, &mut data);
    out.push(("Coriolis", data.coriolis_matrix.as_slice().to_vec()));

    assert!(cholesky(&mut data), "M is positive definite");
    let mut x = state.tau.clone();
    data.mass_matrix_factor.solve(&mut x);
    out.push(("solution", x));
    mass_matrix_inverse(&mut data);
    out.push(("inverse", data.mass_matrix_inverse.as_slice().to_vec()));
    let mut half = Matrix6xX::zeros(model.n());
    frame_jacobian(model, &data, tip, &mut half);
    let mobility = data.mass_matrix_factor.mobility(&mut half);
    out.push(("mobility", mobility.as_slice().to_vec()));
    data.mass_matrix_factor.finish_solve(&mut half);
    out.push(("J M⁻¹", half.as_slice().to_vec()));

    let wrenches = [(tip, state.wrench), (second, -state.wrench)];
    rnea(model, &mut data, &state.ddq);
    out.push(("inverse dynamics", data.torque.as_slice().to_vec()));
    rnea_external(model, &mut data, &state.ddq, &wrenches);
    out.push(("inverse dynamics with wrenches", data.torque.as_slice().to_vec()));
    aba(model, &mut data, &state.tau);
    out.push(("forward dynamics", data.ddq.as_slice().to_vec()));
    aba_external(model, &mut data, &state.tau, &wrenches);
    out.push(("forward dynamics with wrenches", data.ddq.as_slice().to_vec()));
    rnea_derivatives(model, &mut data, &state.ddq);
    out.push(("∂τ/∂q", data.torque_by_q.as_slice().to_vec()));
    out.push(("∂τ/∂q̇", data.torque_by_dq.as_slice().to_vec()));
    aba_derivatives(model, &mut data, &state.tau);
    out.push(("∂q̈/∂q", data.ddq_by_q.as_slice().to_vec()));
    out.push(("∂q̈/∂q̇", data.ddq_by_dq.as_slice().to_vec()));
    let mut regressor = DMatrix::zeros(model.n(), 10 * model.bodies().len());
    torque_regressor(model, &mut data, &state.ddq, &mut regressor);
    out.push(("regressor", regressor.as_slice().to_vec()));
}

fn everything<T: Real>(model: &Model<T>, frames: [FrameId; 2], state: &State<T>) -> Results<T> {
    let mut out = Vec::new();
    motions(model, frames, state, &mut out);
    dynamics(model, frames, state, &mut out);
    out
}

/// Returns four states: the state of the case, and three states at increasing distances from it.
fn states(case: &Case, wrench: &Force) -> [State<f64>; batch::COUNT] {
    std::array::from_fn(|lane| {
        let by = lane as f64;
        State {
            q: case.moved(&case.dq, 0.7 * by).q,
            dq: plus(&case.dq, &case.ddq, 0.2 * by),
            ddq: plus(&case.ddq, &case.tau, -0.1 * by),
            tau: plus(&case.tau, &case.tau, -0.4 * by),
            wrench: *wrench * (1.0 - 0.3 * by),
        }
    })
}

fn side_by_side(states: &[State<f64>; batch::COUNT]) -> State<Lanes> {
    let gathered = |pick: fn(&State<f64>) -> &[f64]| {
        let mut out = vec![Lanes::from([f64::NAN; batch::COUNT]); pick(&states[0]).len()];
        batch::gather(&states.each_ref().map(pick), &mut out);
        out
    };
    let axis =
        |pick: &dyn Fn(&Force, usize) -> f64, i| Lanes::from(states.each_ref().map(|s| pick(&s.wrench, i)));
    State {
        q: gathered(|s| &s.q),
        dq: gathered(|s| &s.dq),
        ddq: gathered(|s| &s.ddq),
        tau: gathered(|s| &s.tau),
        wrench: Force {
            linear: Vector3::from_fn(|i, _| axis(&|f, i| f.linear[i], i)),
            angular: Vector3::from_fn(|i, _| axis(&|f, i| f.angular[i], i)),
        },
    }
}

proptest! {
    #![proptest_config(config(128))]

    /// Compared: each lane of every result, and the result of the same algorithm for the state of that lane alone.
    #[test]
    fn lanes_match_single_state_results(case in case(), wrench in wrench()) {
        let frames = [case.tip, case.second];
        let states = states(&case, &wrench);
        let together = everything(&case.model.splat::<Lanes>(), frames, &side_by_side(&states));
        for (lane, state) in states.iter().enumerate() {
            let alone = everything(&case.model, frames, state);
            prop_assert_eq!(alone.len(), together.len());
            for ((name, alone), (_, together)) in alone.iter().zip(&together) {
                let mut extracted = vec![f64::NAN; together.len()];
                batch::extract(together, lane, &mut extracted);
                close(alone, &extracted, ROUNDING)
                    .map_err(|e| TestCaseError::fail(format!("{name}, lane {lane}: {e}")))?;
            }
        }
    }

    /// Checks that a non-finite state in any lane makes the factor unusable and does not affect the kinematics of the
    /// other lanes.
    #[test]
    fn non_finite_lane_is_detected(case in case(), bad in 0..batch::COUNT) {
        let model = case.model.splat::<Lanes>();
        let mut states = states(&case, &Force::zero());
        let mut data = Data::new(&model);
        let good = side_by_side(&states);
        prop_assert!(update(&model, &mut data, &good.q, &good.dq));
        let velocity = frame_velocity(&model, &data, case.tip);
        states[bad].q.fill(f64::NAN);
        let State { q, dq, .. } = side_by_side(&states);
        prop_assert!(!update(&model, &mut data, &q, &dq));
        let beside = frame_velocity(&model, &data, case.tip);
        for lane in (0..batch::COUNT).filter(|&lane| lane != bad) {
            let (mut a, mut b) = ([0.0; 3], [0.0; 3]);
            batch::extract(velocity.linear.as_slice(), lane, &mut a);
            batch::extract(beside.linear.as_slice(), lane, &mut b);
            prop_assert_eq!(a, b);
        }
    }
}
