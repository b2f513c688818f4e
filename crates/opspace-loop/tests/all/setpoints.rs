//! Tests of the guard of a position robot's setpoints: following error and reach of the servos.

use crate::common::{
    self, Commanded, KP, KV, LIMITS, PERIOD_S, Received, START, Scripted, at_rest, capabilities, config,
    drive_robot, holding_setpoint, position_controller, run,
};
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::quantity::NonNegative;
use opspace_loop::{Fault, LoopConfig, Phase, SafetyParameters};
use opspace_transformer::{PaperTransformer, ServoGains};
use std::sync::atomic::AtomicBool;

/// Rounding of a few operations on numbers of order 1.
const ROUNDING: f64 = 1e-12;
/// A tenth of the effect of one encoder count, rad.
const SETPOINT: f64 = 1e-6;
/// Speed limit of the joints, rad/s.
const SPEED: f64 = 5.0;

/// Distance from the measured position at which a servo gives full torque at full speed, rad:
/// (τ_max / kv + v_max) / kp.
fn reach(joint: usize) -> f64 {
    (LIMITS[joint] / KV[joint] + SPEED) / KP[joint]
}

/// Compared: the following error at the fault, for a blocked joint whose setpoints move on and for a setpoint that
/// jumps, and the reach by hand plus the motion in one period.
#[test]
fn excess_following_error_faults() {
    for (speed, jump) in [(3.0, 0.0), (0.0, 0.5)] {
        let controller =
            position_controller(move |time_s| speed * time_s + if time_s > 0.1 { jump } else { 0.0 });
        let record = run(CommandKind::Position, controller, 0.2, at_rest);
        let Fault::FollowingError { joint, error, limit } = *record.fault() else {
            panic!("{:?}", record.outcome)
        };
        assert_eq!(joint, 1);
        assert!(error > limit && (limit - reach(1) - SPEED * PERIOD_S).abs() < ROUNDING, "{error} {limit}");
        record.check_fault_rows(Phase::Control);
        let commands = record.commands();
        for received in commands {
            let Received::Positions(q) = received else { panic!("{received:?}") };
            assert!((q[1] - START[1]).abs() <= limit, "never sent: {q}");
        }
        let Some(Received::Positions(last)) = commands.last() else { panic!("{:?}", record.received) };
        assert!((last - holding_setpoint(&START)).amax() < SETPOINT, "held at its position: {last}");
    }
}

/// Compared: the setpoints of a transformer with servo gains a hundred times too low, and the reach by hand around the
/// measured position.
#[test]
fn setpoints_are_clamped_around_measured_position() {
    let controller = Commanded::torques(|_, _, tau| tau.copy_from_slice(&[1e6, -1e6]));
    let soft = |i: usize| ServoGains { stiffness: KP[i] * KV[i] / 100.0, damping: KV[i] };
    let position = capabilities(CommandKind::Position);
    let config = LoopConfig {
        transformer: Box::new(PaperTransformer::new(vec![soft(0), soft(1)])),
        safety: SafetyParameters { torque_ramp_s: NonNegative::default(), ..common::safety() },
        ..config(position.clone(), controller)
    };
    let robot = Scripted::new(position, at_rest);
    let record = drive_robot(config, 0.01, &AtomicBool::new(false), robot);
    let expected = DVector::from_vec(vec![START[0] + reach(0), START[1] - reach(1)]);
    let Received::Positions(q) = &record.commands()[0] else { panic!("{:?}", record.received) };
    assert!((q - &expected).amax() < ROUNDING, "{q}");
    let last = record.rows.len() - 1;
    assert!((record.values(last, "q_desired")[0] - expected[0]).abs() < ROUNDING);
    assert_eq!(record.values(last, "setpoint_clamped"), [1.0, 1.0]);
}
