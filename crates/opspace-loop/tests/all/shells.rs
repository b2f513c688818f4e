//! Tests of the two ways to execute a run: fed manually, as by a robot's callback, and driven.

use crate::common::cases::{Case, DURATION_S, cases};
use crate::common::{
    KINDS, REST, Received, Record, Rows, capabilities, config, drive_robot, gravity_controller,
};
use opspace_backend::{CommandKind, DeviceFault, Sample, TICK};
use opspace_loop::{ControlLoop, LoopConfig, Run};
use std::sync::atomic::AtomicBool;

fn parts(kind: CommandKind) -> LoopConfig {
    config(capabilities(kind), gravity_controller(3.0))
}

fn run_driven(case: &Case, kind: CommandKind) -> Record {
    let stop_request = AtomicBool::new(false);
    let robot = case.robot(kind, &stop_request);
    drive_robot(parts(kind), DURATION_S, &stop_request, robot)
}

/// Runs the case without a backend, by calling `Run::cycle`.
fn run_fed(case: &Case, kind: CommandKind, device_fault: &DeviceFault) -> Record {
    let stop_request = AtomicBool::new(false);
    let control = ControlLoop::new(parts(kind)).expect("parts that fit");
    let layout = Run::layouts(&control, None).swap_remove(TICK);
    let mut rows = Rows::default();
    let mut run = Run::new(control, DURATION_S, &mut rows).with_stop_request(&stop_request);
    let mut sample = Sample::new(&capabilities(kind));
    let (mut received, mut received_in): (Vec<Received>, Vec<u64>) = (Vec::new(), Vec::new());
    for cycle in 0.. {
        if run.is_over() {
            break;
        }
        let command = if case.unreadable.contains(&cycle) {
            run.fail(device_fault.clone())
        } else {
            case.fill_sample(cycle, &mut sample, &stop_request);
            run.cycle(&sample)
        };
        if let Some(command) = command {
            received.push(command.into());
            received_in.push(cycle);
            if case.refused == Some(cycle) {
                run.refuse(device_fault.clone());
            }
        }
    }
    let outcome = run.finish();
    Record { outcome, received, received_in, times_s: rows.times_s, rows: rows.rows, layout }
}

/// Removes the calls of `stop` from a record.
fn without_stops(record: Record) -> Record {
    let calls = record.received.into_iter().zip(record.received_in);
    let (received, received_in) = calls.filter(|(received, _)| *received != Received::Stop).unzip();
    Record { received, received_in, ..record }
}

/// Compared bit for bit: rows, time stamps, commands and outcome of a driven run, and of a run that is fed manually
/// with the same samples.
#[test]
fn manually_fed_run_equals_driven_run() {
    for kind in KINDS {
        for case in cases() {
            let driven = without_stops(run_driven(&case, kind));
            let device_fault = case.robot(kind, &AtomicBool::new(false)).device_fault;
            let by_hand = run_fed(&case, kind, &device_fault);
            let name = format!("{kind:?}, {}", case.name);
            assert_eq!(driven.text(), by_hand.text(), "{name}");
            assert_eq!(format!("{:?}", driven.times_s), format!("{:?}", by_hand.times_s), "{name}");
            assert_eq!(driven.row_bits(), by_hand.row_bits(), "{name}");
            assert_eq!(driven.layout, by_hand.layout, "{name}");
        }
    }
}

/// Returns the expected number of commands in a cycle: none at rest and after the stop, one in control, and in the
/// stopping cycle the last setpoint of a robot that accepts setpoints. A rejected command counts as written.
fn expected_writes(case: &Case, kind: CommandKind, cycle: u64) -> usize {
    let is_last = cycle == case.stops_in;
    let has_last = case.stops_by_refusal || (kind != CommandKind::Torque && case.known);
    usize::from(if is_last { has_last } else { (REST..case.stops_in).contains(&cycle) })
}

/// Compared: the number of writes in each cycle, and the expected number.
#[test]
fn robot_gets_at_most_one_command_per_cycle() {
    for kind in KINDS {
        for case in cases() {
            let record = run_driven(&case, kind);
            let name = format!("{kind:?}, {}", case.name);
            let cycles = record.received_in.last().expect("it is stopped") + 1;
            for cycle in 0..cycles {
                let calls = record.received_in.iter().zip(&record.received);
                let writes =
                    calls.filter(|(at, received)| **at == cycle && **received != Received::Stop).count();
                assert_eq!(writes, expected_writes(&case, kind, cycle), "{name}, cycle {cycle}");
            }
            let _ = record.commands();
        }
    }
}

/// Compared: the cycles in which `stop` is called, and the stopping cycle and the last one.
#[test]
fn robot_is_stopped_in_stop_cycle_and_at_end() {
    for kind in KINDS {
        for case in cases() {
            let record = run_driven(&case, kind);
            let calls = record.received_in.iter().zip(&record.received);
            let stops: Vec<u64> =
                calls.filter(|(_, received)| **received == Received::Stop).map(|(at, _)| *at).collect();
            let [first, last] = stops[..] else { panic!("{kind:?}, {}: {stops:?}", case.name) };
            assert_eq!(first, case.stops_in, "{kind:?}, {}", case.name);
            assert!(last >= first);
        }
    }
}
