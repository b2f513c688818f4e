//! Tests that the robot's clock may start at any time.

use crate::common::{Commanded, KINDS, Record, START, Scripted, capabilities, config, drive_robot};
use opspace_backend::{CommandKind, Sample};
use opspace_loop::{Fault, Phase, RunOutcome};
use std::sync::atomic::AtomicBool;

/// Period whose multiples, also added to whole seconds, are exact floats, s.
const PERIOD_S: f64 = 1.0 / 1024.0;
/// Cycle before which cycles are missed.
const AFTER: u64 = 100;
/// Cycle in which the second script faults.
const WRONG: u64 = 250;

/// Runs a swaying robot, with two missed cycles and later a dropout, on a clock that starts at `start_s`.
fn run_on_clock(kind: CommandKind, start_s: f64, faults: bool) -> Record {
    let mut capabilities = capabilities(kind);
    capabilities.period_s = PERIOD_S;
    let script = move |cycle: u64, sample: &mut Sample| {
        let missed = 2 * u64::from(cycle >= AFTER / 2) + 30 * u64::from(cycle >= AFTER);
        sample.time_s = start_s + (cycle + missed) as f64 * PERIOD_S;
        let sway = if cycle < AFTER { 0.01 * (0.1 * cycle as f64).sin() } else { 0.0 };
        sample.q.copy_from_slice(&[START[0] + sway, START[1] - 2.0 * sway]);
        if faults && cycle >= WRONG {
            sample.wrenches[0][2] = f64::NAN;
        }
    };
    let controller = Commanded::torques(|data, measurement, tau| {
        for (i, tau) in tau.iter_mut().enumerate() {
            *tau = data.gravity[i] + 3.0 * measurement.time_s - 0.7 * measurement.dq[i];
        }
    });
    let robot = Scripted::new(capabilities.clone(), script);
    drive_robot(config(capabilities, controller), 0.5, &AtomicBool::new(false), robot)
}

/// Compared bit for bit: rows, commands and outcome with clocks that start at 1000 s, 5 s before zero and one period
/// before zero, and with a clock that starts at zero; and time stamps minus the start.
#[test]
fn clock_start_shifts_only_time_stamps() {
    for kind in KINDS {
        for faults in [false, true] {
            let zero = run_on_clock(kind, 0.0, faults);
            let phases = zero.phases();
            let has = |phase: Phase| phases.contains(&phase.code());
            assert!(has(Phase::Held) && has(Phase::Resuming), "{kind:?}: {:?}", zero.outcome);
            match zero.outcome {
                RunOutcome::Completed => assert!(!faults),
                _ => assert_eq!(*zero.fault(), Fault::SensorNotFinite { sensor: 0 }),
            }
            for start_s in [1000.0, -5.0, -PERIOD_S] {
                let shifted = run_on_clock(kind, start_s, faults);
                let name = format!("{kind:?} from {start_s} s");
                assert_eq!(shifted.text(), zero.text(), "{name}");
                assert_eq!(shifted.row_bits(), zero.row_bits(), "{name}");
                let times_s: Vec<f64> = shifted.times_s.iter().map(|time_s| time_s - start_s).collect();
                assert_eq!(times_s, zero.times_s, "{name}");
            }
        }
    }
}
