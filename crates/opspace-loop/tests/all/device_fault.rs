//! Tests of faults that the robot itself reports when it is read or written.

use crate::common::{
    self, AFTERMATH, KINDS, REST, Record, Scripted, at_rest, capabilities, config, drive_robot,
    gravity_controller, model,
};
use opspace_backend::{CommandKind, DEVICE_FAILED, DeviceFault};
use opspace_loop::{Fault, Phase, RunOutcome};
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Cycle of the fault, counted from the first read.
const WRONG: u64 = 60;
/// Code of device faults in the rows.
const CODE: f64 = 17.0;
/// Rounding of sums of times, s.
const ROUNDING: f64 = 1e-9;

fn reported() -> DeviceFault {
    DeviceFault::new(31, "joint 2: the brake is closed")
}

fn run_with_faults(kind: CommandKind, unreadable: Range<u64>, refused: Option<u64>) -> Record {
    let robot = Scripted {
        unreadable,
        refused,
        device_fault: reported(),
        ..Scripted::new(capabilities(kind), at_rest)
    };
    drive_robot(config(capabilities(kind), gravity_controller(3.0)), 0.2, &AtomicBool::new(false), robot)
}

/// Checks outcome and rows: `before` rows without a fault, then a row with the device fault in `phase`.
fn check(record: &Record, before: u64, phase: Phase, time_s: f64) {
    let RunOutcome::Faulted { fault, time_s: at_s } = &record.outcome else { panic!("{:?}", record.outcome) };
    assert_eq!(*fault, Fault::Device(reported()));
    assert!((at_s - time_s).abs() < ROUNDING, "{at_s} s");
    assert_eq!(fault.describe(&model()), "the robot reports: joint 2: the brake is closed (code 31)");
    let row = before as usize;
    let failed = record.scalar(DEVICE_FAILED);
    assert_eq!((failed[row], failed.iter().sum::<f64>()), (1.0, 1.0), "in one row");
    assert_eq!(record.scalar("fault")[row], CODE);
    assert_eq!(record.scalar("fault")[..row].iter().sum::<f64>(), 0.0);
    assert_eq!(record.phases()[row], phase.code());
}

/// Checks outcome and rows of a run in which one cycle can't be read: the device's code and text, and 0.2 s of further
/// rows.
#[test]
fn fault_at_read_stops_the_robot() {
    for kind in KINDS {
        let record = run_with_faults(kind, WRONG..WRONG + 1, None);
        check(&record, WRONG, Phase::Control, (WRONG - 1 - REST) as f64 * common::PERIOD_S);
        assert_eq!(record.check_fault_rows(Phase::Control), WRONG as usize);
        assert_eq!(record.commands().len(), (WRONG - REST) as usize, "nothing after the fault");
    }
}

/// Checks that a robot that can't be read any more has no rows after that of the fault.
#[test]
fn lasting_read_fault_records_no_further_rows() {
    for kind in KINDS {
        let record = run_with_faults(kind, WRONG..u64::MAX, None);
        check(&record, WRONG, Phase::Control, (WRONG - 1 - REST) as f64 * common::PERIOD_S);
        assert_eq!(record.rows.len(), WRONG as usize + 1);
    }
}

/// Checks outcome, rows and commands of a run whose first cycle can't be read: one fault at rest and a stop.
#[test]
fn first_read_fault_stops_without_command() {
    for kind in KINDS {
        let record = run_with_faults(kind, 0..1, None);
        check(&record, 0, Phase::Rest, 0.0);
        assert_eq!(record.check_fault_rows(Phase::Rest), 0);
        assert_eq!(record.commands(), []);
    }
}

/// Checks outcome and rows of a run in which a command is rejected: the device's code and text; the rejected command
/// has a row and is the last one.
#[test]
fn fault_at_write_stops_the_robot() {
    for kind in KINDS {
        let record = run_with_faults(kind, 0..0, Some(WRONG));
        check(&record, WRONG + 1, Phase::Control, (WRONG - REST) as f64 * common::PERIOD_S);
        assert_eq!(record.check_fault_rows(Phase::Control), WRONG as usize + 1);
        assert_eq!(record.rows.len(), WRONG as usize + 2 + AFTERMATH);
        assert_eq!(record.times_s[WRONG as usize], record.times_s[WRONG as usize + 1], "one cycle");
        assert_eq!(record.commands().len(), (WRONG + 1 - REST) as usize);
    }
}
