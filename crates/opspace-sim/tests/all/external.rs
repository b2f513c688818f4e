//! Tests of external forces during a simulation.

use crate::common::{START, arm, parsed, read, setup};
use nalgebra::{DVector, Matrix6xX, Vector3};
use opspace_backend::quantity::NonNegative;
use opspace_backend::{Command, CommandKind, GroundTruth, TruthRow};
use opspace_model::{Data, Force, crba, frame_jacobian, frame_placement, kinematics};
use opspace_sim::{ArmConfig, ExternalForce, Pull, SimulatedArm, external};

/// Returns an arm that accepts external forces, without friction.
fn arm_with_external_forces(command: CommandKind) -> ArmConfig {
    let mut config = setup(command, "a-med");
    config.external_forces = true;
    config.simulated.true_over_nominal.friction = NonNegative::literal(0.0);
    let quality = config.simulated.force_sensor.get_mut("wrist").expect("the wrist");
    *quality = parsed("bandwidth_hz = 500.0\nnoise_n = 0.0\nnoise_nm = 0.0\nbias_n = 0.0\nbias_nm = 0.0");
    config
}

/// Returns the rows of the channel `external` of the last read, with their times.
fn rows(arm: &SimulatedArm) -> Vec<(f64, Vec<f64>)> {
    let mut rows = Vec::new();
    arm.visit(&mut |row| {
        if let TruthRow::External { time_s, row } = row {
            rows.push((time_s, row.to_vec()));
        }
    });
    rows
}

/// Returns the Jacobian of the hand's origin and the hand's position at `q`.
fn hand(config: &ArmConfig, q: &DVector<f64>) -> (Matrix6xX<f64>, Vector3<f64>) {
    let model = &config.model;
    let mut data = Data::new(model);
    kinematics(model, &mut data, q.as_slice(), &[0.0; 4]);
    let frame = model.frame_id("hand").expect("the hand");
    let mut jacobian = Matrix6xX::zeros(model.n());
    frame_jacobian(model, &data, frame, &mut jacobian);
    (jacobian, frame_placement(model, &data, frame).translation)
}

/// Compared: the displacement of each joint of a position robot under a constant force, and Jᵀ F over the servo's
/// stiffness kv kp. After the release the joints return.
#[test]
fn push_deflects_a_position_robot_by_force_over_stiffness() {
    /// Change of gravity and of the Jacobian caused by the deflection, relative to the deflection.
    const CURVATURE: f64 = 0.03;
    let config = arm_with_external_forces(CommandKind::Position);
    let force = Vector3::new(12.0, -7.0, 15.0);
    let gains: Vec<f64> = config.servos.iter().map(|servo| servo.gains(2e-4).stiffness).collect();
    let (jacobian, _) = hand(&config, &DVector::from_column_slice(&START));
    let torque = jacobian.rows(0, 3).tr_mul(&force);
    let expected = DVector::from_fn(4, |i, _| torque[i] / gains[i]);
    let frame = config.model.frame_id("hand").expect("the hand");
    let mut arm = arm(config);
    let handle = arm.external_force().expect("it may be pulled");
    handle.apply(frame, Pull::Wrench(Force { linear: force, angular: Vector3::zeros() }));
    (0..600).for_each(|_| drop(read(&mut arm)));
    let moved = arm.true_q() - DVector::from_column_slice(&START);
    assert!(expected.amax() > 2e-3, "{expected}");
    assert!((&moved - &expected).amax() < CURVATURE * expected.amax(), "{moved} for {expected}");
    handle.release();
    (0..600).for_each(|_| drop(read(&mut arm)));
    assert!((arm.true_q() - DVector::from_column_slice(&START)).amax() < 1e-6);
}

/// Compared: the velocity that a torque robot without gravity gains in one cycle under a wrench, and M⁻¹ Jᵀ F times the
/// period, with M from the composite-rigid-body algorithm.
#[test]
fn push_accelerates_a_torque_robot_by_its_inertia() {
    /// Change of inertia and velocity products during the cycle, relative to the velocity.
    const CURVATURE: f64 = 1e-3;
    let mut config = arm_with_external_forces(CommandKind::Torque);
    config.capabilities.gravity_compensated_by = opspace_backend::GravityCompensation::Robot;
    let wrench = Force { linear: Vector3::new(3.0, -2.0, 4.0), angular: Vector3::new(0.2, 0.4, -0.3) };
    let (jacobian, _) = hand(&config, &DVector::from_column_slice(&START));
    let mut data = Data::new(&config.model);
    kinematics(&config.model, &mut data, &START, &[0.0; 4]);
    crba(&config.model, &mut data);
    let torque = jacobian.rows(0, 3).tr_mul(&wrench.linear) + jacobian.rows(3, 3).tr_mul(&wrench.angular);
    let acceleration = data.mass_matrix.clone().lu().solve(&torque).expect("regular");
    let frame = config.model.frame_id("hand").expect("the hand");
    let mut arm = arm(config);
    let handle = arm.external_force().expect("it may be pulled");
    // The first cycle has no force, so that the brakes are released before the force begins.
    for cycle in 0..3 {
        if cycle == 1 {
            handle.apply(frame, Pull::Wrench(wrench));
        }
        read(&mut arm);
        opspace_backend::Backend::write(&mut arm, Command::Torque(&[0.0; 4])).expect("it takes them");
    }
    let expected = acceleration * 1e-3;
    let gained = arm.true_dq();
    assert!(expected.amax() > 5e-3);
    assert!((&gained - &expected).amax() < CURVATURE * expected.amax(), "{gained} for {expected}");
}

/// Compared: the rows of the channel `external` and the force that was set; a spring's force and its stiffness times
/// its elongation; the force sensor's reading and that force; the force decoded from a row and the force that was set.
#[test]
fn external_forces_are_read_and_recorded_every_cycle() {
    const STIFFNESS: f64 = 150.0;
    let config = arm_with_external_forces(CommandKind::Position);
    let model = config.model.clone();
    let frame = model.frame_id("hand").expect("the hand");
    let (_, home) = hand(&config, &DVector::from_column_slice(&START));
    let mut arm = arm(config.clone());
    let layout = arm.layouts().external.expect("there may be external forces");
    let width = layout.width();
    let handle = arm.external_force().expect("it may be pulled");
    read(&mut arm);
    assert_eq!((rows(&arm)[0].0, rows(&arm)[0].1[0], rows(&arm).len()), (0.0, 0.0, 1));
    let target_m = home + Vector3::new(0.1, 0.05, -0.02);
    let pull = Pull::Spring { target_m, stiffness_n_per_m: STIFFNESS, damping_ns_per_m: 4.0 };
    handle.apply(frame, pull);
    let mut sample = read(&mut arm);
    let first = rows(&arm).remove(0).1;
    assert_eq!(first.len(), width);
    assert_eq!(&first[2..5], target_m.as_slice());
    assert_eq!(&first[13..16], [0.0; 3], "it acts from this cycle on");
    assert_eq!(external::decode(&first, &model), Some(ExternalForce { frame, pull }));
    assert_eq!(handle.get(), Some(ExternalForce { frame, pull }));
    for _ in 0..600 {
        sample = read(&mut arm);
    }
    let force = Vector3::from_column_slice(&rows(&arm).remove(0).1[13..16]);
    let (_, x) = hand(&config, &arm.true_q());
    let expected = (target_m - x) * STIFFNESS;
    assert!(expected.norm() > 5.0 && (force - expected).norm() < 1e-3, "{force} for {expected}");
    let mut data = Data::new(&model);
    kinematics(&model, &mut data, arm.true_q().as_slice(), &[0.0; 4]);
    let axes = frame_placement(&model, &data, frame).rotation;
    let sensed = axes * Vector3::from_column_slice(&sample.wrenches[0][..3]);
    assert!((sensed - force).norm() < 1e-3, "{sensed} for {force}");
    let wrench = Pull::Wrench(Force { linear: Vector3::x(), angular: Vector3::y() });
    handle.apply(frame, wrench);
    read(&mut arm);
    let decoded = external::decode(&rows(&arm)[0].1, &model);
    assert_eq!(decoded, Some(ExternalForce { frame, pull: wrench }));
    handle.set(None);
    read(&mut arm);
    assert_eq!(external::decode(&rows(&arm)[0].1, &model), None);
    read(&mut arm);
    assert_eq!(&rows(&arm)[0].1[13..16], [0.0; 3]);
}

/// Compared: the force of a drag in the rows and, at rest, its stiffness times the distance of the dragged point from the target; the
/// force beyond the largest one, and the largest one; the force decoded from a row and the force that was set. A row of an older log
/// has no point.
#[test]
fn drag_acts_on_a_point_and_has_a_largest_force() {
    const STIFFNESS: f64 = 150.0;
    let config = arm_with_external_forces(CommandKind::Position);
    let model = config.model.clone();
    let frame = model.frame_id("hand").expect("the hand");
    let point_m = Vector3::new(0.02, -0.05, 0.04);
    let mut arm = arm(config.clone());
    let handle = arm.external_force().expect("it may be pulled");
    let placed = |arm: &SimulatedArm| {
        let mut data = Data::new(&model);
        kinematics(&model, &mut data, arm.true_q().as_slice(), &[0.0; 4]);
        let hand = frame_placement(&model, &data, frame);
        (hand.translation + hand.rotation * point_m, hand)
    };
    let target_m = placed(&arm).0 + Vector3::new(0.1, 0.05, -0.02);
    let drag = |largest_force_n| Pull::Drag {
        point_m,
        target_m,
        stiffness_n_per_m: STIFFNESS,
        damping_ns_per_m: 4.0,
        largest_force_n,
    };
    for (largest_force_n, is_reached) in [(60.0, false), (3.0, true)] {
        let pull = drag(largest_force_n);
        handle.apply(frame, pull);
        (0..800).for_each(|_| drop(read(&mut arm)));
        let row = rows(&arm).remove(0).1;
        assert_eq!(external::decode(&row, &model), Some(ExternalForce { frame, pull }));
        assert_eq!(external::decode(&row[..16], &model), None);
        let (force, (x, _)) = (Vector3::from_column_slice(&row[13..16]), placed(&arm));
        let spring = (target_m - x) * STIFFNESS;
        let expected = if is_reached { spring * (largest_force_n / spring.norm()) } else { spring };
        assert!(spring.norm() > 5.0 && (force - expected).norm() < 1e-3, "{force} for {expected}");
    }
    let (x, hand) = placed(&arm);
    let wrench = drag(3.0).wrench(&hand, &opspace_model::Motion::zero());
    let moment = (x - hand.translation).cross(&wrench.linear);
    assert!((wrench.angular - moment).norm() < 1e-12 && moment.norm() > 0.01);
}

/// Compared: true states of an arm under forces set in each cycle, and of one that repeats the forces of its rows.
#[test]
fn forces_of_a_log_repeat_its_simulation() {
    let config = arm_with_external_forces(CommandKind::Position);
    let model = config.model.clone();
    let frame = model.frame_id("hand").expect("the hand");
    let mut pulled = arm(config.clone());
    let handle = pulled.external_force().expect("it may be pulled");
    let mut logged = Vec::new();
    for cycle in 0..200 {
        let target_m = Vector3::new(0.5, 1e-3 * f64::from(cycle), 0.4);
        let pull = Pull::Spring { target_m, stiffness_n_per_m: 100.0, damping_ns_per_m: 1.0 };
        handle.set((cycle % 50 > 20).then_some(ExternalForce { frame, pull }));
        read(&mut pulled);
        logged.extend(rows(&pulled).iter().map(|(_, row)| external::decode(row, &model)));
    }
    let mut repeated = arm(config);
    repeated.external_force().expect("it may be pulled").repeat(logged);
    (0..200).for_each(|_| drop(read(&mut repeated)));
    assert_eq!((pulled.true_q(), pulled.true_dq()), (repeated.true_q(), repeated.true_dq()));
    assert_ne!(pulled.true_q(), DVector::from_column_slice(&START));
}

/// Compared: layouts and true states of an arm that accepts external forces but receives none, and of an arm that
/// accepts none.
#[test]
fn arms_without_external_forces_have_no_channel() {
    let config = ArmConfig { external_forces: false, ..arm_with_external_forces(CommandKind::Position) };
    let (mut free, mut closed) = (arm(arm_with_external_forces(CommandKind::Position)), arm(config));
    assert!(closed.external_force().is_none() && closed.layouts().external.is_none());
    for _ in 0..50 {
        assert_eq!(read(&mut free), read(&mut closed));
        assert!(rows(&closed).is_empty());
    }
    assert_eq!(free.true_q(), closed.true_q());
}
