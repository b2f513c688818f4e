//! Tests of faults of measurements and commands, on a robot of each kind.
//!
//! Compared in all tests: the commands that the scripted robot receives in each cycle, and the rules of a safe stop.
//! The robot never moves by itself.

use crate::common::{
    self, Commanded, KINDS, KV, PERIOD_S, REST, Received, Record, START, at_rest, gravity_at,
    gravity_controller, model, run,
};
use nalgebra::DVector;
use opspace_backend::{CommandKind, Sample};
use opspace_loop::{Fault, Phase};

/// Cycle in which the scripted fault begins, counted from the first read.
const WRONG: u64 = 60;
/// Planned duration, s.
const DURATION_S: f64 = 0.2;

/// A tenth of the effect of one encoder count or of one percent of a holding torque, rad or rad/s.
const SETPOINT: f64 = 1e-6;

fn assert_fault(script: impl Fn(u64, &mut Sample) + Copy, expected: &Fault) {
    for kind in KINDS {
        let record = run(kind, gravity_controller(0.0), DURATION_S, script);
        // Clock faults contain times; the debug text compares them, including NaN.
        assert_eq!(format!("{:?}", record.fault()), format!("{expected:?}"), "{kind:?}");
        check_stop(kind, &record);
    }
}

/// Checks the state after a fault: one command for each cycle before it, one last setpoint and nothing after it; the
/// fault in every row from then on.
fn check_stop(kind: CommandKind, record: &Record) {
    let faulted = record.check_fault_rows(Phase::Control);
    let before = faulted - REST as usize;
    let commands = record.commands();
    assert!(!commands.contains(&Received::Hold));
    let weight = gravity_at(&START);
    let (last, expected) = match (kind, commands.last().expect("it was commanded")) {
        (CommandKind::Torque, _) => return assert_eq!(commands.len(), before, "no torques at the stop"),
        (CommandKind::Position, Received::Positions(q)) => (q, common::holding_setpoint(&START)),
        (CommandKind::Velocity, Received::Velocities(dq)) => {
            (dq, DVector::from_fn(2, |i, _| weight[i] / KV[i]))
        }
        (_, last) => panic!("{last:?}"),
    };
    assert!((last - expected).amax() < SETPOINT, "held at its position: {last}");
    assert_eq!(commands.len(), before + 1);
}

#[test]
fn non_finite_measurement_faults() {
    let position = |cycle, sample: &mut Sample| {
        at_rest(cycle, sample);
        if cycle == WRONG {
            sample.q[1] = f64::NAN;
        }
    };
    assert_fault(position, &Fault::MeasurementNotFinite { joint: 1 });
    let motor_torque = |cycle, sample: &mut Sample| {
        at_rest(cycle, sample);
        let torque = sample.motor_torque.as_mut().expect("measured");
        torque[0] = if cycle == WRONG { f64::INFINITY } else { 0.0 };
    };
    assert_fault(motor_torque, &Fault::MeasurementNotFinite { joint: 0 });
    let wrench = |cycle, sample: &mut Sample| {
        at_rest(cycle, sample);
        sample.wrenches[0][4] = if cycle >= WRONG { f64::NAN } else { 0.0 };
    };
    assert_fault(wrench, &Fault::SensorNotFinite { sensor: 0 });
}

#[test]
fn stalled_backward_or_nan_clock_faults() {
    let before_s = (WRONG - 1) as f64 * PERIOD_S;
    for now_s in [before_s, 0.001, f64::NAN] {
        let script = move |cycle, sample: &mut Sample| {
            at_rest(cycle, sample);
            if cycle == WRONG {
                sample.time_s = now_s;
            }
        };
        assert_fault(script, &Fault::Clock { before_s, now_s });
    }
}

/// Checks that a robot whose first position is not finite receives no command: it must not go to a position that was
/// never measured.
#[test]
fn unread_robot_gets_no_setpoint() {
    for kind in KINDS {
        let record = run(kind, gravity_controller(0.0), DURATION_S, |cycle, sample| {
            at_rest(cycle, sample);
            sample.q[0] = f64::NAN;
        });
        assert_eq!(*record.fault(), Fault::MeasurementNotFinite { joint: 0 });
        assert_eq!(record.commands(), []);
        assert_eq!(record.received_in[0], 0, "stopped at once");
    }
}

#[test]
fn non_finite_command_never_reaches_the_robot() {
    for kind in KINDS {
        let controller = Commanded::torques(|data, measurement, tau| {
            tau.copy_from_slice(data.gravity.as_slice());
            if measurement.time_s > 0.05 {
                tau[1] = f64::NAN;
            }
        });
        let record = run(kind, controller, DURATION_S, at_rest);
        assert_eq!(*record.fault(), Fault::CommandNotFinite { joint: 1 });
        assert_eq!(
            record.fault().describe(&model()),
            "joint 'elbow': the controller's command is not a finite number"
        );
        check_stop(kind, &record);
        let finite = record.received.iter().all(|received| match received {
            Received::Positions(v) | Received::Velocities(v) | Received::Torques(v) => {
                v.iter().all(|v| v.is_finite())
            }
            Received::Hold | Received::Stop => true,
        });
        assert!(finite);
    }
}

/// Compared: the position at the fault, and the first scripted position beyond the limit and its margin.
#[test]
fn joint_limit_violation_faults() {
    // The joint drifts slowly beyond 2 rad and the margin of 0.05 rad.
    let record = run(CommandKind::Torque, gravity_controller(0.0), DURATION_S, |cycle, sample| {
        at_rest(cycle, sample);
        sample.q[1] = 1.99 + 1e-3 * cycle as f64;
    });
    let Fault::JointLimit { joint, q, lower, upper } = *record.fault() else {
        panic!("{:?}", record.outcome)
    };
    assert_eq!((joint, lower, upper), (1, -2.05, 2.05));
    assert!((2.05..2.052).contains(&q), "in the first cycle beyond: {q}");
}

/// Compared: speed and limit of the fault, and the script's 7 rad/s and the limit of 5 rad/s.
#[test]
fn speed_limit_violation_faults() {
    let record = run(CommandKind::Torque, gravity_controller(0.0), DURATION_S, |cycle, sample| {
        at_rest(cycle, sample);
        sample.q[0] -= 7.0 * PERIOD_S * cycle.saturating_sub(WRONG) as f64;
    });
    let Fault::Speed { joint, dq, limit } = *record.fault() else { panic!("{:?}", record.outcome) };
    assert_eq!((joint, limit), (0, 5.0));
    assert!((-7.0..-5.0).contains(&dq), "{dq}");
}
