//! The integrator, in the plant that the experiments use.

mod common;

use common::{START, robot, setup};
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_model::{Data, Limits, Model, kinematics, kinetic_energy, potential_energy};
use opspace_sim::RungeKutta;
use opspace_sim::friction::LuGre;
use opspace_sim::motor::Motor;
use opspace_sim::plant::{Plant, PlantParts};

/// The plant of the experiments with friction scaled to nothing, no end stops and nothing around it.
fn frictionless(dt: f64, q: &[f64]) -> Plant {
    let (robot, setup) = (robot(), setup(CommandKind::Torque, "a-med"));
    let n = setup.model.n();
    let mut model = setup.model;
    for joint in 0..n {
        model.set_limits(joint, Limits::NONE);
    }
    Plant::new(PlantParts {
        friction: setup
            .joints
            .iter()
            .map(|j| LuGre::new(&j.friction, &robot.simulated.bristle, 0.0))
            .collect(),
        motors: (0..n).map(|_| Motor::new(Some(1000.0), dt, 0.0)).collect(),
        end_stop: robot.simulated.end_stop,
        brake: robot.simulated.brake,
        brake_torque: DVector::zeros(n),
        contacts: Vec::new(),
        q: DVector::from_column_slice(q),
        model,
    })
}

/// Kinetic and potential energy.
fn energy(model: &Model, data: &mut Data, q: &DVector<f64>, dq: &DVector<f64>) -> (f64, f64) {
    kinematics(model, data, q.as_slice(), dq.as_slice());
    (kinetic_energy(model, data), potential_energy(model, data))
}

/// Compared: energy from masses, positions and speeds, and its value at the start. The plant moves by
/// articulated bodies and knows no energy.
#[test]
fn a_swinging_arm_without_friction_keeps_its_energy() {
    /// Of the range of kinetic energy over the swing.
    const DRIFT: f64 = 1e-6;
    let steps_per_s = robot().simulated.physics_hz.get();
    let dt = 1.0 / steps_per_s;
    let mut plant = frictionless(dt, &START);
    let model = plant.model().clone();
    let mut data = Data::new(&model);
    let (_, start) = energy(&model, &mut data, plant.q(), plant.dq());
    let (mut drift, mut slowest, mut fastest) = (0.0_f64, f64::INFINITY, 0.0_f64);
    for step in 0..(5.0 * steps_per_s) as u32 {
        plant.step(f64::from(step) * dt, dt, &[0.0; 4]);
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

/// Where a swing of `duration_s` ends with steps of `dt`: all positions and speeds.
fn swing(model: &Model, dt: f64, duration_s: f64) -> DVector<f64> {
    let mut integrator = RungeKutta::new(model);
    let mut q = DVector::from_column_slice(&START);
    let mut dq = DVector::zeros(model.n());
    for _ in 0..(duration_s / dt).round() as u32 {
        integrator.step(model, &mut q, &mut dq, &[0.0; 4], dt);
    }
    DVector::from_iterator(2 * model.n(), q.iter().chain(dq.iter()).copied())
}

/// Compared: swings with coarse steps and one with steps 64 times as fine. Halving the step divides the error of
/// a method of order p by 2^p.
#[test]
fn the_integrator_is_of_fourth_order() {
    const DURATION_S: f64 = 1.28;
    let model = setup(CommandKind::Torque, "a-med").model;
    let exact = swing(&model, 0.02 / 256.0, DURATION_S);
    let errors: Vec<f64> =
        [0.02, 0.01, 0.005].iter().map(|&dt| (swing(&model, dt, DURATION_S) - &exact).norm()).collect();
    for pair in errors.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        assert!((3.7..4.6).contains(&order), "order {order} from errors {errors:?}");
    }
}
