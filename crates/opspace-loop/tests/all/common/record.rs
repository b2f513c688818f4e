//! Record of a run on a scripted robot.

use super::{AFTERMATH, Received, Scripted, capabilities, config};
use opspace_backend::{CommandKind, Layout, Sample, Sink, TICK};
use opspace_control::Controller;
use opspace_loop::{ControlLoop, Fault, LoopConfig, Phase, Run, RunOutcome, drive};
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Sink that keeps the rows of the cycles, with their time stamps (s).
#[derive(Default)]
pub struct Rows {
    pub times_s: Vec<f64>,
    pub rows: Vec<Vec<f64>>,
}

impl Sink for Rows {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        if channel == TICK {
            self.times_s.push(time_s);
            self.rows.push(row.to_vec());
        }
    }
}

/// Results of a run.
pub struct Record {
    pub outcome: RunOutcome,
    /// Calls of `write` and `stop`, in their order.
    pub received: Vec<Received>,
    /// Cycle of each of them.
    pub received_in: Vec<u64>,
    pub times_s: Vec<f64>,
    pub rows: Vec<Vec<f64>>,
    pub layout: Layout,
}

impl Record {
    /// Columns of a signal.
    pub fn columns(&self, name: &str) -> Range<usize> {
        columns(&self.layout, name)
    }

    /// Values of a signal with one element, row by row.
    pub fn scalar(&self, name: &str) -> Vec<f64> {
        let columns = self.columns(name);
        assert_eq!(columns.len(), 1, "{name}");
        self.rows.iter().map(|row| row[columns.start]).collect()
    }

    /// Values of a signal in one row.
    pub fn values(&self, row: usize, name: &str) -> &[f64] {
        &self.rows[row][self.columns(name)]
    }

    pub fn phases(&self) -> Vec<f64> {
        self.scalar("phase")
    }

    pub fn fault(&self) -> &Fault {
        let RunOutcome::Faulted { fault, .. } = &self.outcome else { panic!("{:?}", self.outcome) };
        fault
    }

    /// Commands up to the stop. Only stops may follow.
    pub fn commands(&self) -> &[Received] {
        let end =
            self.received.iter().position(|received| *received == Received::Stop).expect("it is stopped");
        assert!(
            self.received[end..].iter().all(|received| *received == Received::Stop),
            "nothing is written after a stop"
        );
        &self.received[..end]
    }

    /// Rows as bits.
    pub fn row_bits(&self) -> Vec<Vec<u64>> {
        self.rows.iter().map(|row| row.iter().map(|value| value.to_bits()).collect()).collect()
    }

    /// Calls with their cycles, and the outcome, as text. The debug text of a float is unique.
    pub fn text(&self) -> String {
        format!("{:?}\n{:?}\n{:?}", self.received, self.received_in, self.outcome)
    }

    /// Checks the rows around a fault: its code from one row on, which is still in `phase`, then the setpoints of the stop, and 0.2 s
    /// of a stopped robot. Returns the index of the first row with the code.
    pub fn check_fault_rows(&self, phase: Phase) -> usize {
        let code = f64::from(self.fault().code());
        let (faults, phases) = (self.scalar("fault"), self.phases());
        let first = faults.iter().position(|fault| *fault != 0.0).expect("the fault is in a row");
        assert!(faults[first..].iter().all(|fault| *fault == code), "latched");
        assert_eq!(phases[first], phase.code());
        let stopping =
            phases[first + 1..].iter().take_while(|phase| **phase == Phase::Stopping.code()).count();
        let aftermath = &phases[first + 1 + stopping..];
        assert!(aftermath.iter().all(|phase| *phase == Phase::Stopped.code()), "stopped");
        // The last of several setpoints of a stop has a row of its own.
        let rows = aftermath.len();
        assert!(rows == AFTERMATH || rows == AFTERMATH + 1, "0.2 s of aftermath, {rows}");
        first
    }
}

pub fn columns(layout: &Layout, name: &str) -> Range<usize> {
    let place = layout.signals.iter().position(|signal| signal.name == name);
    let place = place.unwrap_or_else(|| panic!("no signal '{name}'"));
    let start = layout.signals[..place].iter().map(|signal| signal.len()).sum();
    start..start + layout.signals[place].len()
}

/// Drives a robot for `duration_s` (s) of control, or until `stop_request` is set.
pub fn drive_robot<F: FnMut(u64, &mut Sample)>(
    config: LoopConfig,
    duration_s: f64,
    stop_request: &AtomicBool,
    mut robot: Scripted<F>,
) -> Record {
    let control = ControlLoop::new(config).unwrap_or_else(|e| panic!("{e}"));
    let layout = Run::layouts(&control, None).swap_remove(TICK);
    let mut rows = Rows::default();
    let mut run = Run::new(control, duration_s, &mut rows).with_stop_request(stop_request);
    drive(&mut robot, &mut run);
    assert!(run.is_over(), "it is driven to its end");
    let outcome = run.finish();
    let Scripted { received, received_in, .. } = robot;
    let Rows { times_s, rows } = rows;
    Record { outcome, received, received_in, times_s, rows, layout }
}

/// Runs a controller for `duration_s` (s) on a robot of that kind.
pub fn run(
    kind: CommandKind,
    controller: impl Controller + 'static,
    duration_s: f64,
    script: impl FnMut(u64, &mut Sample),
) -> Record {
    let robot = Scripted::new(capabilities(kind), script);
    drive_robot(config(capabilities(kind), controller), duration_s, &AtomicBool::new(false), robot)
}
