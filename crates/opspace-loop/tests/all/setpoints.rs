//! Tests of the guard of a position robot's setpoints: following error and reach of the servos.

use crate::common::{
    self, Commanded, KP, KV, LIMITS, PERIOD_S, REST, Received, START, Scripted, at_rest, capabilities,
    config, drive_robot, holding_setpoint, position_controller, run,
};
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::quantity::NonNegative;
use opspace_loop::{Fault, LoopConfig, Phase, RunOutcome, SafetyParameters};
use opspace_testing::random::Random;
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
/// jumps, and the reach by hand plus the motion in one period. No setpoint steps further than that motion.
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
        let mut before: Option<&DVector<f64>> = None;
        for received in commands {
            let Received::Positions(q) = received else { panic!("{received:?}") };
            assert!((q[1] - START[1]).abs() <= limit, "never sent: {q}");
            if let Some(before) = before.replace(q) {
                assert!((q - before).amax() <= SPEED * PERIOD_S + ROUNDING, "{before} {q}");
            }
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
    assert!((record.values(REST as usize, "q_desired")[0] - expected[0]).abs() < ROUNDING);
    assert_eq!(record.values(REST as usize, "setpoint_clamped"), [1.0, 1.0]);
}

/// Compared: the steps of the setpoints of torques that jump between the limits, and the speed limit times the period; and
/// the number of clamped setpoints, and the steps of that size.
#[test]
fn no_setpoint_steps_further_than_the_speed_limit() {
    let mut random = Random(5);
    let controller = Commanded::torques(move |_, _, tau| {
        tau.iter_mut().zip(LIMITS).for_each(|(tau, limit)| *tau = random.between(-0.5, 0.5) * limit);
    });
    let record = run(CommandKind::Position, controller, 0.25, at_rest);
    assert_eq!(record.outcome, RunOutcome::Completed);
    let setpoint = |received: &Received| match received {
        Received::Positions(q) => q.clone(),
        other => panic!("{other:?}"),
    };
    let setpoints: Vec<_> = record.commands().iter().map(setpoint).collect();
    let step = SPEED * PERIOD_S;
    let steps = setpoints.windows(2).map(|pair| (&pair[1] - &pair[0]).abs());
    let (mut full, mut total) = (0, 0);
    for of_joints in steps {
        assert!(of_joints.amax() <= step + ROUNDING, "{of_joints}");
        full += of_joints.iter().filter(|size| **size > step - ROUNDING).count();
        total += 2;
    }
    assert!(full > 20 && full < total, "{full} of {total}");
    let clamped: f64 = (0..record.rows.len()).flat_map(|row| record.values(row, "setpoint_clamped")).sum();
    assert!(clamped >= full as f64, "{clamped} of {full}");
}
