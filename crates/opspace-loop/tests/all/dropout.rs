//! Tests of missed interface cycles on a scripted robot.
//!
//! Compared in all tests: the commands that the scripted robot receives in each cycle, and the rules of holding and
//! resuming.

use crate::common::{
    Commanded, KINDS, PERIOD_S, REST, Received, Record, at_rest, gravity_controller, model, run, servo_torque,
};
use opspace_backend::{CommandKind, Sample};
use opspace_loop::{Fault, Phase, RunOutcome};
use std::sync::{Arc, Mutex};

/// Rounding of sums of times and positions of order 1, s and rad/s.
const ROUNDING: f64 = 1e-9;
/// Rounding of a few operations on numbers of order 1.
const EPSILON: f64 = 1e-12;
/// Cycle before which cycles are missed, counted from the first.
const AFTER: u64 = 60;
/// Number of commands before [`AFTER`].
const BEFORE: usize = (AFTER - REST) as usize;
/// Number of cycles for which a robot must be at rest before it is commanded again.
const STILL: usize = 50;
/// Number of cycles of the torque ramp.
const RAMP: usize = 100;
/// Tolerance far below all commanded torques, Nm.
const TORQUE: f64 = 1e-9;

/// Time of a cycle on the robot's clock, with `missed` missed cycles before cycle [`AFTER`], s.
fn delayed_clock_s(cycle: u64, missed: u64) -> f64 {
    (cycle + if cycle >= AFTER { missed } else { 0 }) as f64 * PERIOD_S
}

/// Script of a robot at rest with that many missed cycles.
fn missing_cycles(missed: u64) -> impl FnMut(u64, &mut Sample) + Copy {
    move |cycle, sample| {
        at_rest(cycle, sample);
        sample.time_s = delayed_clock_s(cycle, missed);
    }
}

/// Setpoints in the row of a cycle; empty for a torque robot.
fn setpoints(record: &Record, kind: CommandKind, row: u64) -> &[f64] {
    let row = row as usize;
    match kind {
        CommandKind::Position => record.values(row, "q_desired"),
        CommandKind::Velocity => record.values(row, "dq_desired"),
        CommandKind::Torque => &[],
    }
}

/// Compared: the controller's velocity of a joint with constant speed, and that speed; the run's cycles including
/// missed ones, and the planned duration.
#[test]
fn few_missed_cycles_are_tolerated() {
    const SPEED: f64 = 1.3;
    for missed in 1..=3 {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let log = Arc::clone(&seen);
        let controller = Commanded::torques(move |data, measurement, tau| {
            tau.copy_from_slice(data.gravity.as_slice());
            log.lock().expect("one thread").push((measurement.time_s, measurement.dq[0]));
        });
        let record = run(CommandKind::Torque, controller, 0.2, move |cycle, sample| {
            at_rest(cycle, sample);
            sample.time_s = delayed_clock_s(cycle, missed);
            sample.q[0] += SPEED * sample.time_s;
        });
        assert_eq!(record.outcome, RunOutcome::Completed);
        assert!(record.phases()[REST as usize..].iter().all(|p| *p == Phase::Control.code()));
        assert_eq!(record.scalar("missed_cycles")[AFTER as usize], missed as f64);
        let seen = seen.lock().expect("one thread");
        // The filter of 150 Hz starts at zero; after 40 ms the remaining error is a factor e^-38.
        let settled = seen.iter().filter(|(time_s, _)| *time_s > 0.04);
        settled
            .for_each(|(time_s, dq)| assert!((dq - SPEED).abs() < ROUNDING, "{missed}: {dq} at {time_s} s"));
        assert_eq!(seen.len() as u64 + missed, 200, "the planned duration");
        let last_s = seen.last().expect("cycles").0;
        assert!((last_s - 0.199).abs() < ROUNDING, "{last_s} s");
    }
}

/// Compared: the commands after a dropout of 0.1 s, and holds followed by the weight plus a ramp; the setpoints during
/// the hold, and the last ones before (zero for a velocity robot). The phases of the cycles are checked too.
#[test]
fn robot_is_held_after_dropout_then_torques_ramp_in() {
    const EXTRA: f64 = 6.0;
    for kind in KINDS {
        let record = run(kind, gravity_controller(EXTRA), 0.5, missing_cycles(100));
        assert_eq!(record.outcome, RunOutcome::Completed);
        let commands = record.commands();
        let held = &commands[BEFORE..BEFORE + STILL];
        assert!(held.iter().all(|received| *received == Received::Hold), "{kind:?}");
        let kept = match kind {
            CommandKind::Velocity => &[0.0; 2][..],
            _ => setpoints(&record, kind, AFTER - 1),
        };
        for row in AFTER..AFTER + STILL as u64 {
            assert_eq!(setpoints(&record, kind, row), kept, "{kind:?}, row {row}");
        }
        let start = servo_torque(&commands[0]);
        for (k, received) in commands[BEFORE + STILL..].iter().enumerate().take(2 * RAMP) {
            let share = (k as f64 / RAMP as f64).min(1.0);
            let error = servo_torque(received) - start.add_scalar(share * EXTRA);
            assert!(error.amax() < TORQUE, "{kind:?}, cycle {k}: off by {error}");
        }
        let phases = &record.phases()[AFTER as usize..];
        let lasts = |phase: Phase| phases.iter().filter(|p| **p == phase.code()).count();
        assert_eq!((lasts(Phase::Held), lasts(Phase::Resuming)), (STILL, RAMP));
        assert_eq!(phases[0], Phase::Held.code());
        assert_eq!(phases[STILL], Phase::Resuming.code());
        assert_eq!(phases[STILL + RAMP], Phase::Control.code());
    }
}

/// Compared: the number of cycles for which a moving robot is held, and multiples of that for a robot at rest.
#[test]
fn moving_robot_is_held_until_rest() {
    let moves_on = |until: u64| {
        move |cycle: u64, sample: &mut Sample| {
            at_rest(cycle, sample);
            sample.time_s = delayed_clock_s(cycle, 10);
            sample.q[1] += 0.1 * PERIOD_S * (cycle.min(until) as f64 - AFTER as f64).max(0.0);
        }
    };
    for kind in KINDS {
        let record = run(kind, gravity_controller(0.0), 0.5, moves_on(AFTER + 120));
        assert_eq!(record.outcome, RunOutcome::Completed);
        let held = record.phases().iter().filter(|p| **p == Phase::Held.code()).count();
        // The test runs every 50 ms: the robot still moves at the third test, but not at the fourth.
        assert_eq!(held, 4 * STILL, "{kind:?}");

        let record = run(kind, gravity_controller(0.0), 3.0, moves_on(u64::MAX));
        let Fault::HoldFailed { joint: 1, held_s } = *record.fault() else { panic!("{:?}", record.outcome) };
        assert!((1.0..1.06).contains(&held_s), "{held_s} s");
        assert!(record.fault().describe(&model()).contains("joint 'elbow'"));
        record.check_fault_rows(Phase::Held);
    }
}

/// Compared: the last command, and the first, which balances the weight at rest.
#[test]
fn too_long_dropout_stops_the_robot() {
    for kind in KINDS {
        let record = run(kind, gravity_controller(3.0), 3.0, missing_cycles(1001));
        let Fault::Dropout { silent_s, limit_s } = *record.fault() else { panic!("{:?}", record.outcome) };
        assert!((silent_s - 1.001).abs() < ROUNDING && limit_s == 1.0, "{silent_s} s, {limit_s} s");
        let commands = record.commands();
        if kind == CommandKind::Torque {
            assert_eq!(commands.len(), BEFORE, "no command after the dropout");
        } else {
            assert_eq!(commands.len(), BEFORE + 1, "one last setpoint");
            assert_eq!(commands.last(), commands.first(), "held where it is");
        }
        assert_eq!(
            run(kind, gravity_controller(3.0), 3.0, missing_cycles(1000)).outcome,
            RunOutcome::Completed
        );
    }
}

/// Checks that no command follows a dropout whose first sample is rejected: the robot must not return to the state
/// before the dropout.
#[test]
fn unknown_state_after_dropout_moves_no_setpoint() {
    for kind in KINDS {
        let record = run(kind, gravity_controller(3.0), 0.5, |cycle, sample| {
            at_rest(cycle, sample);
            sample.time_s = delayed_clock_s(cycle, 100);
            sample.q[0] = if cycle >= AFTER { f64::NAN } else { sample.q[0] };
        });
        assert_eq!(*record.fault(), Fault::MeasurementNotFinite { joint: 0 });
        assert_eq!(record.commands().len(), BEFORE, "nothing after the dropout");
    }
}

/// Compared: the last command after an encoder jump by a radian, and the first: the robot is held at the position
/// before the jump.
#[test]
fn position_jump_stops_at_previous_position() {
    for kind in KINDS {
        let record = run(kind, gravity_controller(0.0), 0.5, |cycle, sample| {
            at_rest(cycle, sample);
            sample.q[0] += if cycle >= AFTER { 1.0 } else { 0.0 };
        });
        let Fault::PositionJump { joint: 0, step, limit } = *record.fault() else {
            panic!("{:?}", record.outcome)
        };
        // Motion at twice the speed limit of 5 rad/s, plus a milliradian.
        assert!((step - 1.0).abs() < EPSILON && (limit - 0.011).abs() < EPSILON, "{step} {limit}");
        let commands = record.commands();
        if kind == CommandKind::Torque {
            assert_eq!(commands.len(), BEFORE);
        } else {
            assert_eq!(commands.len(), BEFORE + 1);
            assert_eq!(commands.last(), commands.first());
        }
    }
}
