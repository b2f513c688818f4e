//! Comparison of mass matrices and bias torques.

use crate::common::{mujoco, robots};
use opspace_model::{Data, Limits, Model, bias, crba, kinematics};
use opspace_sim::PlantArm;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Difference of the largest element, relative to the largest element.
const TOLERANCE: f64 = 1e-12;
/// Highest speed of a joint, rad/s or m/s.
const SPEED: f64 = 2.0;

/// Returns a random state within the position limits.
fn state(model: &Model, random: &mut ChaCha8Rng) -> (Vec<f64>, Vec<f64>) {
    let position = |joint: &opspace_model::Joint, random: &mut ChaCha8Rng| {
        let (lower, upper): (f64, f64) = Limits::range(&joint.limits, joint.kind);
        random.random_range(lower..=upper)
    };
    let q = model.joints().iter().map(|joint| position(joint, random)).collect();
    let dq = model.joints().iter().map(|_| random.random_range(-SPEED..=SPEED)).collect();
    (q, dq)
}

/// Compared: mass matrix by the composite-rigid-body algorithm and bias torques by Newton and Euler, with those of
/// MuJoCo, in 50 random states of each robot.
#[test]
fn mass_matrix_and_bias_are_those_of_mujoco() {
    let Some(mujoco) = mujoco(None) else { return };
    for robot in robots() {
        let model = &robot.model;
        let arm = PlantArm::new(model.clone(), vec![0.0; model.n()]);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut data = Data::new(model);
        let (mut worst_mass, mut worst_bias) = (0.0_f64, 0.0_f64);
        for _ in 0..50 {
            let (q, dq) = state(model, &mut random);
            kinematics(model, &mut data, &q, &dq);
            crba(model, &mut data);
            bias(model, &mut data);
            let (mass, forces) = mujoco.dynamics(&arm, &q, &dq).expect("a model");
            worst_mass = worst_mass.max((&mass - &data.mass_matrix).amax() / mass.amax());
            worst_bias = worst_bias.max((&forces - &data.bias).amax() / forces.amax());
        }
        println!("{}: mass matrix {worst_mass:.1e}, bias {worst_bias:.1e}", robot.name());
        assert!(worst_mass < TOLERANCE, "{}: mass matrix differs by {worst_mass:e}", robot.name());
        assert!(worst_bias < TOLERANCE, "{}: bias differs by {worst_bias:e}", robot.name());
    }
}
