//! Tests of the integrator in the plant that the experiments use.

use crate::common::{START, robot, setup};
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_model::{Data, Limits, Model, kinematics, kinetic_energy, potential_energy};
use opspace_sim::drivetrain::{Brake, Drivetrain, Encoder, EndStop};
use opspace_sim::friction::LuGre;
use opspace_sim::motor::Motor;
use opspace_sim::{JointTorque, Midpoint, Plant, PlantArm, PlantConfig, RigidPlant};
use opspace_transformer::JointParameters;

/// Returns plant and drivetrains of the experiments' arm without friction, end stops and environment.
fn frictionless(dt: f64, q: &[f64]) -> (RigidPlant, Vec<Drivetrain>, Model) {
    let (robot, setup) = (robot(), setup(CommandKind::Torque, "a-med"));
    let model = setup.model;
    let drivetrain = |j: &JointParameters| {
        let simulated = &robot.simulated;
        Drivetrain::new(
            Motor::new(Some(1000.0), dt, 0.0),
            LuGre::new(&j.friction, &simulated.bristle_of(&j.friction), 0.0),
            EndStop::new(&Limits::NONE, &simulated.end_stop_of(40.0)),
            Brake::new(&simulated.brake_of(40.0), 0.0),
            Encoder::new(None),
        )
    };
    let drivetrains = setup.joints.iter().map(drivetrain).collect();
    let arm = PlantArm::new(model.clone(), q.to_vec());
    let config = PlantConfig { arms: vec![arm], couplings: Vec::new(), objects: Vec::new(), step_s: dt };
    (RigidPlant::new(config), drivetrains, model)
}

/// Returns kinetic and potential energy, J.
fn energy(model: &Model, data: &mut Data, q: &[f64], dq: &[f64]) -> (f64, f64) {
    kinematics(model, data, q, dq);
    (kinetic_energy(model, data), potential_energy(model, data))
}

/// Compared: kinetic plus potential energy during a motion, and at the start. The plant uses the articulated-body
/// algorithm, which doesn't compute energy.
#[test]
fn frictionless_arm_conserves_energy() {
    /// Tolerance relative to the range of kinetic energy during the swing.
    const DRIFT: f64 = 1e-6;
    let steps_per_s = robot().simulated.physics_hz.get();
    let dt = 1.0 / steps_per_s;
    let (mut plant, mut drivetrains, model) = frictionless(dt, &START);
    let mut data = Data::new(&model);
    let (_, start) = energy(&model, &mut data, plant.q(), plant.dq());
    let (mut drift, mut slowest, mut fastest) = (0.0_f64, f64::INFINITY, 0.0_f64);
    for step in 0..(5.0 * steps_per_s) as u32 {
        let torques: Vec<JointTorque> = (drivetrains.iter_mut().enumerate())
            .map(|(i, joint)| joint.begin_step(plant.q()[i], plant.dq()[i], dt))
            .collect();
        plant.step(f64::from(step) * dt, dt, &torques);
        if step % 20 == 0 {
            let (kinetic, potential) = energy(&model, &mut data, plant.q(), plant.dq());
            drift = drift.max((kinetic + potential - start).abs());
            (slowest, fastest) = (slowest.min(kinetic), fastest.max(kinetic));
        }
    }
    let range = fastest - slowest;
    assert!(range > 0.5, "it does swing: {range} J");
    assert!(drift < DRIFT * range, "{drift} J of {range} J");
}

/// Returns all positions and velocities at the end of a swing of `duration_s` with steps of `dt` (s).
fn swing(model: &Model, dt: f64, duration_s: f64) -> DVector<f64> {
    let mut integrator = Midpoint::new(model);
    let mut q = DVector::from_column_slice(&START);
    let mut dq = DVector::zeros(model.n());
    for _ in 0..(duration_s / dt).round() as u32 {
        integrator.predict(model, q.as_slice(), dq.as_slice(), dt);
        integrator.advance(model, q.as_mut_slice(), dq.as_mut_slice(), &[0.0; 4], dt);
    }
    DVector::from_iterator(2 * model.n(), q.iter().chain(dq.iter()).copied())
}

/// Compared: swings with coarse steps, and one with steps 64 times smaller. Halving the step divides the error of a
/// method of order p by 2^p.
#[test]
fn integrator_is_second_order() {
    const DURATION_S: f64 = 1.28;
    let model = setup(CommandKind::Torque, "a-med").model;
    let exact = swing(&model, 0.02 / 256.0, DURATION_S);
    let errors: Vec<f64> =
        [0.02, 0.01, 0.005].iter().map(|&dt| (swing(&model, dt, DURATION_S) - &exact).norm()).collect();
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((1.8..2.3).contains(&order), "order {order} from errors {errors:?}");
    }
}
