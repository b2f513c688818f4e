//! The simulated servo and its joints.

use opspace_feetech::protocol::{ErrorFlags, Register};
use opspace_feetech::simulated::{
    BusOptions, JointModel, SeparateJoint, SeparateJoints, ServoOptions, SimulatedBus, SimulatedServo,
};
use std::f64::consts::TAU;
use std::time::Duration;

/// Error of a few floating-point operations, Nm or V.
const ROUNDING: f64 = 1e-12;

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

/// By hand: a blocked servo exerts its stall torque for Protection_Time, 2 s, and then Protective_Torque, 20 %, until torque is
/// switched on again.
#[test]
fn overload_reduces_the_torque() {
    let mut servo = SimulatedServo::new(1, ServoOptions::default());
    servo.hold(0.0, 0.0);
    servo.set(Register::GOAL_POSITION, servo.get(Register::PRESENT_POSITION) + 1000);
    let torques: Vec<f64> = (0..2500).map(|_| servo.control(0.0, 0.0, 1e-3)).collect();
    assert!((torques[1990] - 1.91).abs() < ROUNDING, "{}", torques[1990]);
    assert!((torques[2100] - 0.2 * 1.91).abs() < ROUNDING, "{}", torques[2100]);
    assert!(servo.error_flags().contains(ErrorFlags::OVERLOAD));
    servo.write(Register::TORQUE_ENABLE.address, &[0]);
    servo.write(Register::TORQUE_ENABLE.address, &[1]);
    assert!(!servo.error_flags().contains(ErrorFlags::OVERLOAD));
    assert!((servo.control(0.0, 0.0, 1e-3) - 1.91).abs() < ROUNDING);
}

/// By hand: three servos that each exert 0.95 Nm draw 3 · (0.95/1.21) · (0.95/1.91) A; 0.5 Ω drop 0.59 V of 7.4 V, and stiffness with
/// it: the joints sag further.
#[test]
fn supply_sags_under_the_load_of_all_servos() {
    let angles = |resistance_ohm: f64| {
        let joint = SeparateJoint { external_nm: -0.95, coulomb_nm: 0.0, ..SeparateJoint::default() };
        let joints = SeparateJoints::new(vec![joint; 3], &[0.0; 3]);
        let servos = (1..=3).map(|id| {
            let mut servo = SimulatedServo::new(id, ServoOptions::default());
            servo.hold(0.0, 0.0);
            servo
        });
        let options = BusOptions { supply_resistance_ohm: resistance_ohm, ..BusOptions::default() };
        let mut bus = SimulatedBus::new(servos.collect(), Box::new(joints), options);
        bus.advance_to(Duration::from_secs(2));
        let volts = bus.servo(2).expect("a servo").supply_v;
        (volts, bus.joints().q()[1])
    };
    let ((stiff_v, stiff), (soft_v, soft)) = (angles(0.0), angles(0.5));
    let expected = 7.4 - 0.5 * 3.0 * (0.95 / 1.21) * (0.95 / 1.91);
    /// The count of a goal is 0.4 % of this torque, and the current grows with its square.
    const OF_A_COUNT: f64 = 0.03;
    assert!((stiff_v - 7.4).abs() < ROUNDING, "{stiff_v}");
    assert!((soft_v - expected).abs() < OF_A_COUNT * (7.4 - expected), "{soft_v} for {expected}");
    assert!((stiff / soft - expected / 7.4).abs() < OF_A_COUNT, "{stiff} {soft}");
}
