//! Tests of collision detection in the control loop, with a robot at rest whose motors deliver known torques.

use crate::common::{
    PERIOD_S, REST, Received, Record, START, Scripted, at_rest, capabilities, config, drive_robot,
    gravity_at, gravity_controller, parsed, position_controller,
};
use opspace_backend::{CommandKind, Sample};
use opspace_loop::{
    CollisionDetectionParameters, CollisionDetector, ControlLoop, Fault, LoopConfig, LoopError, RunOutcome,
};
use opspace_transformer::FrictionParameters;
use std::sync::atomic::AtomicBool;

/// Cycle in which the arm meets something.
const CONTACT: u64 = 100;

/// Threshold at the shoulder: breakaway 0.5, friction 0.3 of 1.5, a tenth of the motor torque, 1 % of the limit of 40 Nm.
fn threshold(motor: f64) -> f64 {
    0.5 + 0.3 * 1.5 + 0.1 * motor.abs() + 0.4
}

fn detector(text: &str) -> CollisionDetector {
    let friction: FrictionParameters =
        parsed("coulomb_nm = 1.0\nstatic_nm = 1.5\nstribeck_rad_per_s = 0.1\nviscous_nms_per_rad = 0.5");
    let parameters: CollisionDetectionParameters = parsed(text);
    CollisionDetector::new(&parameters, &[friction.clone(), friction], &[40.0, 20.0])
}

/// Run of an arm at rest whose shoulder motor delivers `extra` (Nm) more than the weight from the contact on.
fn pressed(text: &str, extra: f64) -> Record {
    let weight = gravity_at(&START);
    let script = move |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        if let Some(torque) = &mut sample.motor_torque {
            torque.copy_from_slice(weight.as_slice());
            torque[0] += if cycle >= CONTACT { extra } else { 0.0 };
        }
    };
    let robot = capabilities(CommandKind::Torque);
    let parts =
        LoopConfig { collision: Some(detector(text)), ..config(robot.clone(), gravity_controller(1.0)) };
    drive_robot(parts, 0.4, &AtomicBool::new(false), Scripted::new(robot, script))
}

/// Compared: time and torque of the fault, and the first cycle after the contact in which the closed form 15 (1 − (1 + Ko T)⁻ᵏ) Nm of the
/// residual exceeds the threshold.
#[test]
fn external_torque_above_the_threshold_stops_the_robot() {
    let record = pressed("observer_rad_per_s = 150.0", -15.0);
    let motor = gravity_at(&START)[0] - 15.0;
    let residual = |cycles: i32| 15.0 * (1.0 - (1.0_f64 + 150.0 * PERIOD_S).powi(-cycles));
    let cycles = (1..).find(|cycles| residual(*cycles) > threshold(motor)).unwrap_or_default();
    let RunOutcome::Faulted { fault: Fault::Collision { joint, torque, threshold: limit }, time_s } =
        record.outcome
    else {
        panic!("{:?}", record.outcome)
    };
    assert_eq!(joint, 0);
    assert!((limit - threshold(motor)).abs() < 1e-9, "{limit} Nm against {} Nm", threshold(motor));
    assert!((torque - residual(cycles)).abs() < 1e-9, "{torque} Nm against {} Nm", residual(cycles));
    let expected_s = (CONTACT + cycles as u64 - 1 - REST) as f64 * PERIOD_S;
    assert!((time_s - expected_s).abs() < 1e-9, "{time_s} s against {expected_s} s");
}

#[test]
fn external_torque_below_the_threshold_is_no_collision() {
    let record = pressed("", -2.0);
    assert_eq!(record.outcome, RunOutcome::Completed);
}

/// Compared: the torques after a collision, and the weight by hand: the controller's additional 1 Nm is not commanded.
#[test]
fn compliant_robot_only_balances_its_weight() {
    let record = pressed("reaction = 'compliant'", -15.0);
    assert_eq!(record.outcome, RunOutcome::Completed);
    let Some(Received::Torques(last)) = record.commands().last().cloned() else {
        panic!("{:?}", record.received)
    };
    let error = last - gravity_at(&START);
    assert!(error.amax() < 1e-6, "{error}");
    assert_eq!(record.values(record.rows.len() - 1, "collision_detected"), [1.0]);
}

#[test]
fn compliance_without_torques_is_refused() {
    let robot = capabilities(CommandKind::Position);
    let parts = LoopConfig {
        collision: Some(detector("reaction = 'compliant'")),
        ..config(robot, position_controller(|_| 0.0))
    };
    assert_eq!(ControlLoop::new(parts).err(), Some(LoopError::NotCompliant));
}
