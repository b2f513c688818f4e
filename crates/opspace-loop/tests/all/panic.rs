//! Tests of panics in parts of a run: the robot ends in its safe state.

use crate::common::{
    Commanded, KINDS, PERIOD_S, REST, Received, Scripted, at_rest, capabilities, config, gravity_controller,
};
use opspace_backend::{Backend, Capabilities, Command, DeviceFault, Sample, Sink, TICK};
use opspace_control::Controller;
use opspace_loop::{ControlLoop, Fault, Run, RunOutcome, drive};
use std::panic::{set_hook, take_hook};
use std::sync::Once;

/// Cycle of the panic, counted from the first read.
const WRONG: u64 = 60;
/// Message of the panics that a test causes.
const SCRIPTED: &str = "scripted panic";
/// Rounding of sums of times, s.
const ROUNDING: f64 = 1e-9;

/// Suppresses the messages of scripted panics only.
fn silence() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let default = take_hook();
        set_hook(Box::new(move |info| {
            if info.payload_as_str() != Some(SCRIPTED) {
                default(info);
            }
        }));
    });
}

/// Part that panics in cycle [`WRONG`].
#[derive(Clone, Copy, Debug, PartialEq)]
enum Part {
    Controller,
    Read,
    Write,
    Sink,
}

/// Robot that panics when it is written, after this number of commands, or in its first stops.
struct Panicking<B>(B, Option<u64>, u32);

impl<B: Backend> Backend for Panicking<B> {
    fn capabilities(&self) -> &Capabilities {
        self.0.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.0.read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.0.write(command)?;
        if let Some(left) = &mut self.1 {
            assert!(*left > 0, "{SCRIPTED}");
            *left -= 1;
        }
        Ok(())
    }

    fn stop(&mut self) {
        self.0.stop();
        if self.2 > 0 {
            self.2 -= 1;
            panic!("{SCRIPTED}");
        }
    }
}

/// Sink that counts rows and panics after a given number.
struct Counter {
    rows: u64,
    last: Option<u64>,
}

impl Sink for Counter {
    fn row(&mut self, channel: usize, _time_s: f64, _row: &[f64]) {
        if channel == TICK {
            assert!(Some(self.rows) != self.last, "{SCRIPTED}");
            self.rows += 1;
        }
    }
}

/// Controller that balances the weight until it panics.
fn panicking_controller() -> impl Controller {
    Commanded::torques(|data, measurement, tau| {
        let cycle = (measurement.time_s / PERIOD_S).round() as u64 + REST;
        assert!(cycle < WRONG, "{SCRIPTED}");
        tau.copy_from_slice(data.gravity.as_slice());
    })
}

/// Checks outcome, calls and rows of a run in which a part panics in one cycle: a fault, a stop in that cycle, and no
/// cycle after it. A panic of the robot is a fault of the device, which has a row of its own.
#[test]
fn panic_in_any_part_stops_the_robot() {
    silence();
    for kind in KINDS {
        for part in [Part::Controller, Part::Read, Part::Write, Part::Sink] {
            let config = match part {
                Part::Controller => config(capabilities(kind), panicking_controller()),
                _ => config(capabilities(kind), gravity_controller(0.0)),
            };
            let script = |cycle, sample: &mut Sample| {
                assert!(part != Part::Read || cycle < WRONG, "{SCRIPTED}");
                at_rest(cycle, sample);
            };
            let writes = (part == Part::Write).then_some(WRONG - REST);
            let mut robot = Panicking(Scripted::new(capabilities(kind), script), writes, 0);
            let mut counter = Counter { rows: 0, last: (part == Part::Sink).then_some(WRONG) };
            let control = ControlLoop::new(config).expect("parts that fit");
            let mut run = Run::new(control, 0.2, &mut counter);
            drive(&mut robot, &mut run);
            assert!(run.is_over(), "{kind:?}, {part:?}");
            let RunOutcome::Faulted { fault, time_s } = run.finish() else { panic!("{kind:?}, {part:?}") };
            let is_right = match &fault {
                Fault::Device(fault) if part == Part::Read => fault.words.contains("panicked in `read`"),
                Fault::Device(fault) if part == Part::Write => fault.words.contains("panicked in `write`"),
                fault => *fault == Fault::Panicked && matches!(part, Part::Controller | Part::Sink),
            };
            assert!(is_right, "{kind:?}, {part:?}: {fault}");
            let last_s = (WRONG - REST) as f64 * PERIOD_S;
            let expected_s = if part == Part::Read { last_s - PERIOD_S } else { last_s };
            assert!((time_s - expected_s).abs() < ROUNDING, "{kind:?}, {part:?}: {time_s} s");
            let Scripted { received, received_in, .. } = robot.0;
            assert_eq!(received.last(), Some(&Received::Stop), "{kind:?}, {part:?}");
            assert_eq!(received_in.last(), Some(&WRONG), "{kind:?}, {part:?}");
            let commands = (WRONG - REST) as usize + usize::from(part == Part::Write);
            assert_eq!(
                received.iter().filter(|received| **received != Received::Stop).count(),
                commands,
                "{part:?}"
            );
            let rows = match part {
                Part::Controller | Part::Sink => WRONG,
                Part::Read => WRONG + 1,
                Part::Write => WRONG + 2,
            };
            assert_eq!(counter.rows, rows, "{kind:?}, {part:?}");
        }
    }
}

/// Checks that the outcome of a faulted run remains if the robot panics in a cycle after the stop.
#[test]
fn panic_after_stop_keeps_the_outcome() {
    silence();
    let kind = opspace_backend::CommandKind::Position;
    let mut robot = Scripted::new(capabilities(kind), |cycle, sample| {
        assert!(cycle < WRONG + 10, "{SCRIPTED}");
        at_rest(cycle, sample);
        sample.q[0] = if cycle >= WRONG { f64::NAN } else { sample.q[0] };
    });
    let mut counter = Counter { rows: 0, last: None };
    let control =
        ControlLoop::new(config(capabilities(kind), gravity_controller(0.0))).expect("parts that fit");
    let mut run = Run::new(control, 0.2, &mut counter);
    drive(&mut robot, &mut run);
    let RunOutcome::Faulted { fault, .. } = run.finish() else { panic!("it faults") };
    assert_eq!(fault, Fault::MeasurementNotFinite { joint: 0 });
    assert_eq!(counter.rows, WRONG + 10);
    assert_eq!(robot.received.last(), Some(&Received::Stop));
}

/// Checks runs whose planned end is a stop that panics: it is called once more, and the run has failed.
#[test]
fn panicking_stop_is_repeated_once() {
    silence();
    let kind = opspace_backend::CommandKind::Position;
    for (panics, words) in [(1, "panicked in `stop`; the message"), (2, "the robot may still move")] {
        let mut robot = Panicking(Scripted::new(capabilities(kind), at_rest), None, panics);
        let mut counter = Counter { rows: 0, last: None };
        let control =
            ControlLoop::new(config(capabilities(kind), gravity_controller(0.0))).expect("parts that fit");
        let mut run = Run::new(control, 0.2, &mut counter);
        drive(&mut robot, &mut run);
        let RunOutcome::Faulted { fault: Fault::Device(fault), .. } = run.finish() else {
            panic!("{panics}")
        };
        assert!(fault.words.contains(words), "{fault}");
        let stops = robot.0.received.iter().filter(|received| **received == Received::Stop).count();
        // One in the cycle of the end, one after the last cycle, and one more for the panic.
        assert_eq!(stops, 3, "{panics}");
    }
}
