//! Test cases of runs: planned ends, missed cycles, faults, stop requests, device faults.

use super::{PERIOD_S, Scripted, at_rest, capabilities};
use opspace_backend::{CommandKind, Sample};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Planned duration of the cases, s.
pub const DURATION_S: f64 = 0.15;

/// Cycle of the fault or event in most cases, counted from the first read.
pub const WRONG: u64 = 60;

/// Scripted run, and its expected end.
#[derive(Clone)]
pub struct Case {
    pub name: &'static str,
    pub script: fn(u64, &mut Sample),
    /// Cycle from which a stop is requested.
    pub stop_requested_in: Option<u64>,
    /// Cycles that can't be read.
    pub unreadable: Range<u64>,
    /// Cycle in which the robot rejects a command.
    pub refused: Option<u64>,
    /// True if that rejection causes the stop.
    pub stops_by_refusal: bool,
    /// Cycle in which the run must stop.
    pub stops_in: u64,
    /// True if the state at the stop is known, so that a last setpoint can be computed, and the device has no fault.
    pub known: bool,
}

const PLAIN: Case = Case {
    name: "planned end",
    script: at_rest,
    stop_requested_in: None,
    unreadable: 0..0,
    refused: None,
    stops_by_refusal: false,
    stops_in: 159,
    known: true,
};

/// Returns all cases. Missed cycles count towards the planned duration.
pub fn cases() -> Vec<Case> {
    let fault = Case { stops_in: WRONG, ..PLAIN };
    vec![
        PLAIN,
        Case { name: "missed cycles", script: late::<2>, stops_in: 157, ..PLAIN },
        Case { name: "dropout", script: late::<20>, stops_in: 139, ..PLAIN },
        Case { name: "dropout that is too long", script: late::<2000>, ..fault.clone() },
        Case { name: "measurement that is NaN", script: nan, ..fault.clone() },
        Case { name: "dropout, then NaN", script: late_and_nan, known: false, ..fault.clone() },
        Case { name: "clock that stands still at rest", script: stalled, stops_in: 5, ..PLAIN },
        Case { name: "stop request at rest", stop_requested_in: Some(5), stops_in: 5, ..PLAIN },
        Case { name: "stop request", stop_requested_in: Some(80), stops_in: 80, ..PLAIN },
        Case {
            name: "stop request while held",
            script: late::<20>,
            stop_requested_in: Some(80),
            stops_in: 80,
            ..PLAIN
        },
        Case { name: "unreadable from the beginning", unreadable: 0..1, stops_in: 0, known: false, ..PLAIN },
        Case { name: "unreadable once at rest", unreadable: 5..6, stops_in: 5, known: false, ..PLAIN },
        Case { name: "unreadable once", unreadable: WRONG..WRONG + 1, known: false, ..fault.clone() },
        Case { name: "unreadable for good", unreadable: WRONG..u64::MAX, known: false, ..fault.clone() },
        Case { name: "refused command", refused: Some(WRONG), stops_by_refusal: true, ..fault.clone() },
        Case {
            name: "refused hold",
            script: late::<20>,
            refused: Some(70),
            stops_by_refusal: true,
            stops_in: 70,
            ..PLAIN
        },
        Case { name: "refused last setpoint", script: nan, refused: Some(WRONG), ..fault },
    ]
}

impl Case {
    /// Fills the sample of a cycle, and sets the stop request when it is due.
    pub fn fill_sample(&self, cycle: u64, sample: &mut Sample, stop_request: &AtomicBool) {
        (self.script)(cycle, sample);
        if self.stop_requested_in.is_some_and(|from| cycle >= from) {
            stop_request.store(true, Ordering::Relaxed);
        }
    }

    /// Returns a robot that follows the script.
    pub fn robot(
        &self,
        kind: CommandKind,
        stop_request: &AtomicBool,
    ) -> Scripted<impl FnMut(u64, &mut Sample)> {
        let play = |cycle, sample: &mut Sample| self.fill_sample(cycle, sample, stop_request);
        Scripted {
            unreadable: self.unreadable.clone(),
            refused: self.refused,
            ..Scripted::new(capabilities(kind), play)
        }
    }
}

fn late<const MISSED: u64>(cycle: u64, sample: &mut Sample) {
    at_rest(cycle, sample);
    sample.time_s = (cycle + if cycle >= WRONG { MISSED } else { 0 }) as f64 * PERIOD_S;
}

fn nan(cycle: u64, sample: &mut Sample) {
    at_rest(cycle, sample);
    sample.q[0] = if cycle == WRONG { f64::NAN } else { sample.q[0] };
}

fn late_and_nan(cycle: u64, sample: &mut Sample) {
    nan(cycle, sample);
    sample.time_s += if cycle >= WRONG { 20.0 * PERIOD_S } else { 0.0 };
}

fn stalled(cycle: u64, sample: &mut Sample) {
    at_rest(if cycle == 5 { 4 } else { cycle }, sample);
}
