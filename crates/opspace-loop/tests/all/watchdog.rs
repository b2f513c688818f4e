//! Tests of the watchdogs of motor torque and power.

use crate::common::{Commanded, PERIOD_S, REST, Record, at_rest, run};
use nalgebra::DVector;
use opspace_backend::{CommandKind, Sample};
use opspace_loop::{Fault, RunOutcome};
use std::sync::{Arc, Mutex};

/// Cycle in which the motor torque begins to deviate.
const AFTER: u64 = 60;
/// Rounding of a few operations on numbers of order 10.
const ROUNDING: f64 = 1e-12;

/// Script of a motor that produces `more` than the desired torque (Nm), in a joint that moves at `speed` (rad/s).
fn excess_torque(more: f64, speed: f64, weight: Arc<Mutex<DVector<f64>>>) -> impl FnMut(u64, &mut Sample) {
    move |cycle, sample| {
        at_rest(cycle, sample);
        sample.q[1] += speed * PERIOD_S * (cycle as f64 - AFTER as f64).max(0.0);
        let torque = sample.motor_torque.as_mut().expect("measured");
        torque.copy_from_slice(weight.lock().expect("one thread").as_slice());
        torque[1] += if cycle >= AFTER { more } else { 0.0 };
    }
}

fn run_with_excess(kind: CommandKind, more: f64, speed: f64) -> Record {
    let weight = Arc::new(Mutex::new(DVector::zeros(2)));
    let commanded = Arc::clone(&weight);
    let controller = Commanded::torques(move |data, _, tau| {
        tau.copy_from_slice(data.gravity.as_slice());
        commanded.lock().expect("one thread").copy_from(&data.gravity);
    });
    run(kind, controller, 0.3, excess_torque(more, speed, weight))
}

/// Time from the first wrong torque to the fault, s.
fn detection_time_s(record: &Record) -> f64 {
    let RunOutcome::Faulted { time_s, .. } = record.outcome else { panic!("{:?}", record.outcome) };
    time_s - (AFTER - REST) as f64 * PERIOD_S
}

const SERVOS: [CommandKind; 2] = [CommandKind::Position, CommandKind::Velocity];

/// Compared: the time of the fault, and the step response of the mean, whose time constant is 50 ms.
#[test]
fn wrong_motor_torque_stops_the_robot() {
    for kind in SERVOS {
        // The limit is 0.6 of the elbow's 20 Nm: the mean of 14 Nm exceeds it after 50 ms times ln(1/(1 - 12/14)).
        let record = run_with_excess(kind, 14.0, 0.0);
        let Fault::TorqueDeviation { joint: 1, limit, .. } = *record.fault() else {
            panic!("{:?}", record.outcome)
        };
        assert!((limit - 12.0).abs() < ROUNDING, "{limit}");
        let expected_s = 0.05 * (1.0_f64 / (1.0 - 12.0 / 14.0)).ln();
        assert!(
            (detection_time_s(&record) - expected_s).abs() <= 2.0 * PERIOD_S,
            "{} s",
            detection_time_s(&record)
        );
        assert_eq!(run_with_excess(kind, 11.9, 0.0).outcome, RunOutcome::Completed);
    }
}

/// Compared: the time of the fault, and the step response of the mean, whose time constant is 50 ms.
#[test]
fn excess_motor_power_stops_the_robot() {
    for kind in SERVOS {
        // The limit is 0.04 of 20 Nm times 5 rad/s; 8 Nm at 1 rad/s are twice that.
        let record = run_with_excess(kind, 8.0, 1.0);
        let Fault::ExcessPower { joint: 1, limit, .. } = *record.fault() else {
            panic!("{:?}", record.outcome)
        };
        assert!((limit - 4.0).abs() < ROUNDING, "{limit}");
        // Expected: 50 ms times ln 2, plus the lag of the velocity filter.
        assert!(
            (detection_time_s(&record) - 0.05 * 2.0_f64.ln()).abs() < 4.0 * PERIOD_S,
            "{} s",
            detection_time_s(&record)
        );
        // Excess torque that brakes is not a fault.
        assert_eq!(run_with_excess(kind, -10.0, 0.3).outcome, RunOutcome::Completed);
    }
}

/// Checks that a deviation that stops a position robot does not stop a torque robot, whose drives control their torques
/// themselves.
#[test]
fn torque_robot_has_no_watchdog() {
    assert_eq!(run_with_excess(CommandKind::Torque, 14.0, 0.0).outcome, RunOutcome::Completed);
}
