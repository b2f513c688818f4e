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

/// Rounding of sums of some hundred torques (Nm) or periods (s).
const ROUNDING: f64 = 1e-9;

/// Cycle in which the arm meets something.
const CONTACT: u64 = 100;

/// Ko T of the tests.
const GAIN: f64 = 150.0 * PERIOD_S;

/// Bound at the shoulder of an arm that has not moved: breakaway 0.5, unknown friction 1.0, friction error 0.35 of 1.5, play a tenth of 1.35 of 1.5, a tenth of
/// the torque, five times the noise of 0.5 % of 40 Nm.
fn bound(torque: f64) -> f64 {
    0.5 + 1.0 + (0.35 + 0.1 * 1.35) * 1.5 + 0.1 * torque.abs() + 5.0 * 0.2 * (GAIN / (2.0 + GAIN)).sqrt()
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
    scripted(text, script)
}

/// Run of an arm with this script.
fn scripted(text: &str, script: impl FnMut(u64, &mut Sample)) -> Record {
    let robot = capabilities(CommandKind::Torque);
    let parts =
        LoopConfig { collision: Some(detector(text)), ..config(robot.clone(), gravity_controller(1.0)) };
    drive_robot(parts, 0.4, &AtomicBool::new(false), Scripted::new(robot, script))
}

/// Compared: time, torque and threshold of the fault, and the first cycle after the contact in which the closed form
/// 15 (1 − (1 + Ko T)⁻ᵏ) Nm of the residual exceeds the bound, which is low-passed alike. The arm rests: the torque of the model is its
/// weight.
#[test]
fn external_torque_above_the_threshold_stops_the_robot() {
    let record = pressed("observer_rad_per_s = 150.0", -15.0);
    let weight = gravity_at(&START)[0];
    let residual = |cycles: i32| 15.0 * (1.0 - (1.0 + GAIN).powi(-cycles));
    let largest = |residual: f64| f64::max((weight - 15.0).abs(), (weight - 15.0 + residual).abs());
    let (mut cycles, mut threshold) = (0, bound(weight));
    while residual(cycles) <= threshold {
        cycles += 1;
        threshold = (threshold + GAIN * bound(largest(residual(cycles)))) / (1.0 + GAIN);
    }
    let RunOutcome::Faulted { fault: Fault::Collision { joint, torque, threshold: limit }, time_s } =
        record.outcome
    else {
        panic!("{:?}", record.outcome)
    };
    assert_eq!(joint, 0);
    assert!((limit - threshold).abs() < ROUNDING, "{limit} Nm against {threshold} Nm");
    assert!((torque - residual(cycles)).abs() < ROUNDING, "{torque} Nm against {} Nm", residual(cycles));
    let expected_s = (CONTACT + cycles as u64 - 1 - REST) as f64 * PERIOD_S;
    assert!((time_s - expected_s).abs() < ROUNDING, "{time_s} s against {expected_s} s");
}

#[test]
fn external_torque_below_the_threshold_is_no_collision() {
    let record = pressed("", -2.0);
    assert_eq!(record.outcome, RunOutcome::Completed);
}

/// Run of an arm at rest whose shoulder motor delivers 2 Nm less from 0.35 s on: less than the threshold.
fn pressed_slightly(text: &str) -> Record {
    let weight = gravity_at(&START);
    scripted(text, move |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        if let Some(torque) = &mut sample.motor_torque {
            torque.copy_from_slice(weight.as_slice());
            torque[0] -= if cycle >= 350 { 2.0 } else { 0.0 };
        }
    })
}

/// Compared: time and torque of the fault, and the first cycle in which the closed form 2 (1 − (1 + Kf T)⁻ᵏ) of a fast residual with 450
/// rad/s exceeds five times the noise of 0.2 Nm, a tenth of the change of the motor torque, and a tenth of 1.35 Fs. The mean moves by less than 0.1 Nm.
#[test]
fn fast_change_below_the_threshold_is_a_collision() {
    let record = pressed_slightly("");
    let gain = 450.0 * PERIOD_S;
    let limit = 5.0 * 0.2 * (gain / (2.0 + gain)).sqrt() + 0.1 * 2.0 + 1.35 * 1.5 * 0.1;
    let residual = |cycles: i32| 2.0 * (1.0 - (1.0 + gain).powi(-cycles));
    let cycles = (1..).find(|cycles| residual(*cycles) > limit).unwrap_or_default();
    let RunOutcome::Faulted { fault: Fault::Collision { joint: 0, torque, threshold }, time_s } =
        record.outcome
    else {
        panic!("{:?}", record.outcome)
    };
    assert!((threshold - limit).abs() < 0.02, "{threshold} Nm against {limit} Nm");
    assert!((torque - residual(cycles)).abs() < 0.1, "{torque} Nm against {} Nm", residual(cycles));
    let expected_s = (350 + cycles as u64 - 1 - REST) as f64 * PERIOD_S;
    assert!((time_s - expected_s).abs() < ROUNDING, "{time_s} s against {expected_s} s");
}

#[test]
fn fast_change_is_no_collision_without_the_fast_residual() {
    for text in ["fast_residual = false", "expected = 'sensed'"] {
        assert_eq!(pressed_slightly(text).outcome, RunOutcome::Completed, "{text}");
    }
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

const RETRACT: &str = "reaction = { retract = { distance_rad = 0.1, duration_s = 0.2 } }";

/// Time of the collision for which a run ended, s.
fn collision_s(record: &Record) -> f64 {
    match record.outcome {
        RunOutcome::Faulted { fault: Fault::Collision { joint: 0, .. }, time_s } => time_s,
        _ => panic!("{:?}", record.outcome),
    }
}

/// Time at which the pressed arm detects the collision, s.
fn detected_s() -> f64 {
    collision_s(&pressed("", -15.0))
}

/// Checks the torques of an arm that something holds at the start while it retracts.
///
/// Compared: the torques in the cycle 120 of the retraction, and the closed form: motion of the shoulder alone, with the pressure, by
/// `way` (rad) in `duration_s` (s) on the minimum-jerk ramp; mass matrix by hand.
fn check_retraction(text: &str, way: f64, duration_s: f64) {
    let record = pressed(text, -15.0);
    // The retraction begins in the cycle of the detection.
    let (cycles, detection) = (120, (detected_s() / PERIOD_S).round() as usize);
    let Received::Torques(torque) = record.commands()[detection + cycles - 1].clone() else {
        panic!("a torque")
    };
    let (u, omega) = (cycles as f64 * PERIOD_S / duration_s, 15.0);
    let ramp = u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u);
    let speed = 30.0 * u * u * (1.0 - u).powi(2) / duration_s;
    let acceleration = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration_s.powi(2);
    let wanted = way * (acceleration + 2.0 * omega * speed + omega * omega * ramp);
    let (upper, fore) = (0.04 + 2.0 * 0.0625, 0.02 + 0.0625);
    let coupling = 0.5 * 0.25 * START[1].cos();
    let column = [upper + 0.25 + 2.0 * coupling + fore, fore + coupling];
    for (i, inertia) in column.into_iter().enumerate() {
        let (expected, found) = (inertia * wanted, torque[i] - gravity_at(&START)[i]);
        assert!((expected - found).abs() < 1e-6, "joint {i}: {found} Nm against {expected} Nm");
    }
}

#[test]
fn retraction_moves_with_the_external_torque() {
    check_retraction(RETRACT, 0.1, 0.2);
}

/// Compared: a retraction by 1.9 rad, and one by the 1.58 rad up to 0.02 rad before the limit of 2 rad.
#[test]
fn retraction_ends_before_a_position_limit() {
    check_retraction("reaction = { retract = { distance_rad = 1.9, duration_s = 1.0 } }", 1.58, 1.0);
}

/// Compared: the end of the run, and that of an arm that stops at once.
#[test]
fn run_ends_after_the_retraction() {
    let retracted_s = collision_s(&pressed(RETRACT, -15.0));
    assert!((retracted_s - detected_s() - 0.2).abs() < 1.5 * PERIOD_S, "{retracted_s} s");
}

/// Run of an arm that is pressed for 30 ms, and from 80 ms on with the torque `again` (Nm).
fn pressed_again(again: f64) -> Record {
    let weight = gravity_at(&START);
    scripted(RETRACT, move |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        if let Some(torque) = &mut sample.motor_torque {
            torque.copy_from_slice(weight.as_slice());
            torque[0] += match cycle {
                0..CONTACT => 0.0,
                CONTACT..130 => -15.0,
                130..180 => 0.0,
                _ => again,
            };
        }
    })
}

#[test]
fn retraction_ends_at_a_second_contact_behind() {
    let (pushed, hindered) = (pressed_again(-15.0), pressed_again(15.0));
    assert!((collision_s(&pushed) - detected_s() - 0.2).abs() < 1.5 * PERIOD_S, "{:?}", pushed.outcome);
    let after_s = collision_s(&hindered) - (180 - REST) as f64 * PERIOD_S;
    assert!((0.0..0.01).contains(&after_s), "{after_s} s after the second contact");
}

/// Checks that an arm that was lost while it retracted does not continue.
#[test]
fn dropout_ends_the_retraction() {
    let weight = gravity_at(&START);
    let record = scripted(RETRACT, move |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        sample.time_s += if cycle >= 150 { 20.0 * PERIOD_S } else { 0.0 };
        if let Some(torque) = &mut sample.motor_torque {
            torque.copy_from_slice(weight.as_slice());
            torque[0] -= if cycle >= CONTACT { 15.0 } else { 0.0 };
        }
    });
    let expected_s = (150 + 20 - REST) as f64 * PERIOD_S;
    assert!((collision_s(&record) - expected_s).abs() < ROUNDING, "{:?}", record.outcome);
}

/// Compared: 1.875 · 0.6 rad/0.2 s = 5.6 rad/s, and the joints' limit of 5 rad/s.
#[test]
fn retraction_above_the_velocity_limit_is_refused() {
    let robot = capabilities(CommandKind::Position);
    let text = "reaction = { retract = { distance_rad = 0.6, duration_s = 0.2 } }";
    let parts = LoopConfig { collision: Some(detector(text)), ..config(robot, position_controller(|_| 0.0)) };
    let error = ControlLoop::new(parts).err().expect("an error").to_string();
    assert!(error.contains("distance_rad/duration_s") && error.contains("got 5.6"), "{error}");
}
