//! The simulated servo and its joints.

use opspace_feetech::protocol::Register;
use opspace_feetech::simulated::{JointModel, SeparateJoint, SeparateJoints, ServoOptions, SimulatedServo};
use std::f64::consts::TAU;

/// Holds a joint with a weight by a servo for two seconds, and returns its angle, rad.
fn held(weight_nm: f64, change: impl FnOnce(&mut SimulatedServo)) -> f64 {
    let joint = SeparateJoint { weight_nm, coulomb_nm: 0.0, ..SeparateJoint::default() };
    let mut joints = SeparateJoints::new(vec![joint], &[0.0]);
    let mut servo = SimulatedServo::new(1, ServoOptions::default());
    servo.control(0.0, 0.0, 1e-3);
    change(&mut servo);
    servo.write(Register::TORQUE_ENABLE.address, &[1]);
    for _ in 0..2000 {
        let torque = servo.control(joints.q()[0], joints.dq()[0], 1e-3);
        joints.advance(&[torque], 1e-3);
    }
    joints.q()[0]
}

/// By hand: the sag is weight over stiffness, 17.8 Nm/rad at P = 32, to the resolution of two counts.
#[test]
fn sag_is_weight_over_stiffness() {
    for (p, stiffness) in [(16, 8.9), (32, 17.8)] {
        let q = held(-0.5, |servo| servo.set(Register::P_COEFFICIENT, p));
        let expected = -0.5 * q.cos() / stiffness;
        assert!((q - expected).abs() < 2.0 * TAU / 4096.0, "{q} {expected}");
    }
}

/// An error within the dead zone makes no torque: a small weight moves the joint to the end of the zone.
#[test]
fn joint_sags_through_the_dead_zone() {
    let sag = |zone| {
        held(-0.01, |servo| {
            servo.set(Register::CW_DEAD_ZONE, zone);
            servo.set(Register::CCW_DEAD_ZONE, zone);
        })
    };
    let counts = (sag(10) - sag(1)) / (TAU / 4096.0);
    assert!((counts + 9.0).abs() <= 2.0, "{counts}");
}

#[test]
fn torque_is_limited_by_its_register() {
    let q = held(-1.0, |servo| servo.set(Register::TORQUE_LIMIT, 100));
    assert!(q < -1.0, "0.19 Nm do not hold 1 Nm: {q}");
}

/// By hand: 0.5 rad at 0.5 rad/s take a second.
#[test]
fn profile_limits_the_speed() {
    let mut servo = SimulatedServo::new(1, ServoOptions::default());
    servo.control(0.0, 0.0, 1e-3);
    servo.set(Register::GOAL_VELOCITY, (0.5 * 4096.0 / TAU) as i32);
    servo.set(Register::ACCELERATION, 254);
    servo.set(Register::GOAL_POSITION, 2048 + (0.5 * 4096.0 / TAU) as i32);
    servo.write(Register::TORQUE_ENABLE.address, &[1]);
    let joint = SeparateJoint { coulomb_nm: 0.0, ..SeparateJoint::default() };
    let mut joints = SeparateJoints::new(vec![joint], &[0.0]);
    let mut fastest: f64 = 0.0;
    for tick in 0..1500 {
        let torque = servo.control(joints.q()[0], joints.dq()[0], 1e-3);
        joints.advance(&[torque], 1e-3);
        fastest = fastest.max(joints.dq()[0]);
        assert!(tick > 900 || joints.q()[0] < 0.48);
    }
    assert!((joints.q()[0] - 0.5).abs() < 0.01, "{}", joints.q()[0]);
    // The servo overshoots the speed of its profile.
    assert!(fastest < 0.75, "{fastest}");
}

#[test]
fn requests_do_not_write_what_is_only_read() {
    let mut servo = SimulatedServo::new(1, ServoOptions::default());
    servo.control(0.3, 0.0, 1e-3);
    let position = servo.get(Register::PRESENT_POSITION);
    servo.write(Register::PRESENT_POSITION.address, &[1, 2]);
    servo.write(0, &[9, 9, 9, 9]);
    servo.write(200, &[1]);
    assert_eq!(servo.get(Register::PRESENT_POSITION), position);
    assert_eq!(servo.get(Register::MODEL_NUMBER), 777);
}
