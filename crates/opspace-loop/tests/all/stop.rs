//! Tests of stops without a fault: the planned end, and a stop request.

use crate::common::{
    self, AFTERMATH, KINDS, KV, REST, Received, START, Scripted, at_rest, capabilities, config, drive_robot,
    gravity_at, gravity_controller, holding_setpoint,
};
use nalgebra::DVector;
use opspace_backend::{CommandKind, GravityCompensation, STOP_REQUESTED};
use opspace_loop::{Phase, RunOutcome};
use std::sync::atomic::{AtomicBool, Ordering};

/// A tenth of the effect of one encoder count or of one percent of a holding torque, rad or rad/s.
const SETPOINT: f64 = 1e-6;
/// Rounding of sums of times, s.
const ROUNDING: f64 = 1e-9;

/// Checks the single command of a robot that is stopped at rest at [`START`]: it balances the weight.
fn check_holding(kind: CommandKind, commands: &[Received]) {
    let expected = match kind {
        CommandKind::Torque => return assert_eq!(commands, []),
        CommandKind::Position => holding_setpoint(&START),
        CommandKind::Velocity => gravity_at(&START).component_div(&DVector::from_row_slice(&KV)),
    };
    let [Received::Positions(setpoint) | Received::Velocities(setpoint)] = commands else {
        panic!("{commands:?}")
    };
    assert!((setpoint - expected).amax() < SETPOINT, "{setpoint}");
}

/// Compared: commands and rows of a run whose stop is requested from the beginning, and those of a safe stop at rest.
#[test]
fn stop_request_before_control_stops_safely() {
    for kind in KINDS {
        let robot = Scripted::new(capabilities(kind), at_rest);
        let config = config(capabilities(kind), gravity_controller(0.0));
        let record = drive_robot(config, 0.2, &AtomicBool::new(true), robot);
        assert_eq!(record.outcome, RunOutcome::Interrupted { time_s: 0.0 }, "before control");
        assert!(record.scalar("fault").iter().all(|fault| *fault == 0.0), "no fault");
        assert_eq!(record.phases()[0], Phase::Rest.code());
        assert!(record.phases()[1..].iter().all(|phase| *phase == Phase::Stopped.code()));
        assert_eq!(record.rows.len(), 1 + AFTERMATH);
        let requested = record.scalar(STOP_REQUESTED);
        assert_eq!((requested[0], requested[1..].iter().sum::<f64>()), (1.0, 0.0), "in one row");
        check_holding(kind, record.commands());
        assert_eq!(record.received_in[0], 0, "in the cycle of the request");
    }
}

/// Compared: the cycle of a stop request, and the cycle of the row that records it, of the last command and of the
/// outcome.
#[test]
fn stop_request_acts_in_its_cycle() {
    const AT: u64 = 50;
    for kind in KINDS {
        let request = AtomicBool::new(false);
        let robot = Scripted::new(capabilities(kind), |cycle, sample| {
            at_rest(cycle, sample);
            request.store(cycle >= AT, Ordering::Relaxed);
        });
        let record = drive_robot(config(capabilities(kind), gravity_controller(3.0)), 0.2, &request, robot);
        let RunOutcome::Interrupted { time_s } = record.outcome else { panic!("{:?}", record.outcome) };
        assert!((time_s - (AT - REST) as f64 * common::PERIOD_S).abs() < ROUNDING, "{time_s} s");
        let row = record.scalar(STOP_REQUESTED).iter().position(|requested| *requested == 1.0);
        assert_eq!(row, Some(AT as usize));
        check_holding(kind, &record.commands()[(AT - REST) as usize..]);
        let stop =
            record.received.iter().position(|received| *received == Received::Stop).expect("it is stopped");
        assert_eq!(record.received_in[stop], AT);
    }
}

/// Checks rows and commands of a run of 0.05 s: one per cycle; the last command is that of the stop.
#[test]
fn planned_end_replaces_last_command() {
    const CYCLES: usize = 50;
    for kind in KINDS {
        let robot = Scripted::new(capabilities(kind), at_rest);
        let config = config(capabilities(kind), gravity_controller(3.0));
        let record = drive_robot(config, 0.05, &AtomicBool::new(false), robot);
        assert_eq!(record.outcome, RunOutcome::Completed);
        assert_eq!(record.rows.len(), REST as usize + CYCLES);
        assert!(record.phases()[REST as usize..].iter().all(|phase| *phase == Phase::Control.code()));
        check_holding(kind, &record.commands()[CYCLES - 1..]);
    }
}

/// Compared: the last setpoint of a robot that compensates gravity itself, and its position.
#[test]
fn gravity_compensating_robot_stops_at_its_position() {
    let capabilities =
        capabilities(CommandKind::Position).with_gravity_compensated_by(GravityCompensation::Robot);
    let robot = Scripted::new(capabilities.clone(), at_rest);
    let config = config(capabilities, gravity_controller(0.0));
    let record = drive_robot(config, 0.2, &AtomicBool::new(true), robot);
    assert_eq!(record.commands(), [Received::Positions(DVector::from_column_slice(&START))]);
}
