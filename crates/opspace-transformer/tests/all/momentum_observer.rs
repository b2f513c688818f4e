//! Tests of the momentum observer: one joint in closed form, and a simulated arm with a known force.

use nalgebra::{DVector, Matrix3, Matrix6xX, Vector3, Vector6};
use opspace_backend::quantity::Positive;
use opspace_model::{
    Data, Force, Inertia, Joint, JointKind, Limits, Model, Placement, aba_external, frame_jacobian,
    generalized_momentum, kinematics, update,
};
use opspace_transformer::MomentumObserver;
use std::f64::consts::TAU;

fn rad_per_s(value: f64) -> Positive {
    Positive::try_from(value).unwrap_or_else(|e| panic!("{e:?}"))
}

fn vector(values: &[f64]) -> DVector<f64> {
    DVector::from_column_slice(values)
}

/// Compared: the residual of a joint of inertia I that a constant external torque accelerates, and the closed form
/// τ (1 − (1 + Ko T)⁻ᵏ) of (T53); for slow and fast observers, some far faster than the sampling, and with missed cycles.
#[test]
fn residual_of_one_joint_matches_closed_form() {
    const PERIOD_S: f64 = 1e-3;
    let (inertia, external, motor) = (0.7, 1.3, -0.4);
    for corner in [1.0, 60.0, 1e3, 1e6] {
        let mut observer = MomentumObserver::new(1, rad_per_s(corner));
        let (mut momentum, mut expected) = (inertia * 0.2, 0.0);
        observer.update(PERIOD_S, &vector(&[momentum]), &vector(&[motor]));
        assert_eq!(observer.residual()[0], 0.0, "the first sample starts it");
        for cycle in 1..=200 {
            let elapsed_s = if cycle % 7 == 0 { 3.0 * PERIOD_S } else { PERIOD_S };
            momentum += elapsed_s * (motor + external);
            observer.update(elapsed_s, &vector(&[momentum]), &vector(&[motor]));
            expected = external - (external - expected) / (1.0 + corner * elapsed_s);
            let error = (observer.residual()[0] - expected).abs();
            assert!(error < 1e-9, "{corner} rad/s, cycle {cycle}: {error}");
        }
        observer.reset();
        observer.update(PERIOD_S, &vector(&[5.0]), &vector(&[motor]));
        assert_eq!(observer.residual()[0], 0.0, "a jump of the momentum across a reset is no torque");
    }
}

/// Three links of which the first turns about the vertical, with rotors.
fn arm() -> Model {
    let mut model = Model::new("arm");
    let joint = |name: &str| Joint { name: name.into(), kind: JointKind::Continuous, limits: Limits::NONE };
    let link = |mass: f64| Inertia {
        mass,
        com: Vector3::new(0.15, 0.01, 0.02),
        rotational: Matrix3::from_diagonal(&Vector3::new(0.01, 0.03, 0.03)),
    };
    let first = model.add_body(None, Placement::identity(), joint("yaw"), link(3.0));
    let axes = nalgebra::Rotation3::from_euler_angles(TAU / 4.0, 0.0, 0.0).into_inner();
    let hip = Placement { rotation: axes, translation: Vector3::new(0.05, 0.0, 0.2) };
    let second = model.add_body(Some(first), hip, joint("shoulder"), link(2.0));
    let knee = Placement { translation: Vector3::new(0.3, 0.0, 0.0), ..Placement::identity() };
    let third = model.add_body(Some(second), knee, joint("elbow"), link(1.0));
    let tip = Placement { translation: Vector3::new(0.3, 0.0, 0.0), ..Placement::identity() };
    model.add_frame("hand", Some(third), tip);
    model.with_rotor_inertia(&[0.1, 0.2, 0.05])
}

/// Force on the hand that the observer estimates after 0.5 s of motion under a constant force, minus the true one, and the
/// force whose torques are the error of the gravity that the observer takes, `gravity_scale` times the true one, N.
fn force_error(gravity_scale: f64) -> (Vector3<f64>, Vector3<f64>) {
    const PERIOD_S: f64 = 1e-3;
    const STEPS: u32 = 50;
    let model = arm();
    let hand = model.frame_id("hand").unwrap_or_else(|e| panic!("{e:?}"));
    let force = Vector3::new(12.0, -7.0, 20.0);
    let (mut data, mut truth) = (Data::new(&model), Data::new(&model));
    let (mut q, mut dq) = (vec![0.3, 0.4, -1.1], vec![0.5, -0.3, 0.4]);
    let mut observer = MomentumObserver::new(3, rad_per_s(300.0));
    let mut torque = DVector::zeros(3);
    let mut before = DVector::<f64>::zeros(3);
    let mut jacobian = Matrix6xX::zeros(3);
    for cycle in 0..500 {
        assert!(update(&model, &mut data, &q, &dq));
        generalized_momentum(&model, &mut data);
        let rates = &data.kinetic_energy_gradient - &data.gravity * gravity_scale;
        // The torque of the last interval, and the mean of what changes within it.
        let known = &torque + (&before + &rates) * 0.5;
        observer.update(PERIOD_S, &data.momentum, &known);
        before = rates;
        frame_jacobian(&model, &data, hand, &mut jacobian);
        // Holds the arm against weight and force, and swings it.
        let wrench = Vector6::new(force.x, force.y, force.z, 0.0, 0.0, 0.0);
        let swing = (TAU * 1.5 * f64::from(cycle) * PERIOD_S).sin();
        torque = &data.gravity - jacobian.tr_mul(&wrench);
        torque += vector(&[3.0, 2.0, -1.0]) * swing - vector(&dq) * 0.5;
        for _ in 0..STEPS {
            let dt = PERIOD_S / f64::from(STEPS);
            kinematics(&model, &mut truth, &q, &dq);
            let wrench = Force { linear: force, angular: Vector3::zeros() };
            aba_external(&model, &mut truth, torque.as_slice(), &[(hand, wrench)]);
            for i in 0..3 {
                dq[i] += dt * truth.ddq[i];
                q[i] += dt * dq[i];
            }
        }
    }
    let linear = jacobian.fixed_rows::<3>(0).transpose().svd(true, true);
    let force_of = |torque: &DVector<f64>| -> Vector3<f64> {
        let solved = linear.solve(torque, 1e-12).unwrap_or_else(|e| panic!("{e}"));
        Vector3::new(solved[0], solved[1], solved[2])
    };
    (force_of(observer.residual()) - force, force_of(&(&data.gravity * (gravity_scale - 1.0))))
}

/// Compared: the force from the residual, and the true force on the hand of a moving arm without friction.
#[test]
fn force_on_a_moving_arm_is_estimated() {
    let (error, _) = force_error(1.0);
    assert!(error.norm() < 0.1, "{error} N");
}

/// Compared: the error of the force with a gravity that is 10 % too large, and the force that has the same torques as a
/// tenth of the weight.
#[test]
fn wrong_gravity_is_taken_for_force() {
    let (error, bias) = force_error(1.1);
    assert!(bias.norm() > 1.0, "the weight matters: {bias} N");
    assert!((error - bias).norm() < 0.05 * bias.norm() + 0.1, "{error} N against {bias} N");
}
