//! Test of a backend that borrows its handle and is not `Send`.

use crate::common::{
    PERIOD_S, Received, START, Scripted, at_rest, capabilities, config, drive_robot, gravity_controller,
};
use opspace_backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, Sample};
use opspace_loop::{ControlLoop, Run, RunOutcome, drive};
use std::cell::Cell;
use std::rc::Rc;
use std::sync::atomic::AtomicBool;

/// Backend with a borrowed vendor handle, which stores the setpoints of all cycles. Its counter is an `Rc`, so that the
/// backend is not `Send`.
struct Borrowing<'a> {
    capabilities: Capabilities,
    handle: &'a mut Vec<f64>,
    reads: Rc<Cell<u64>>,
}

impl Backend for Borrowing<'_> {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        sample.time_s = self.reads.get() as f64 * PERIOD_S;
        sample.q.copy_from_slice(&START);
        self.reads.set(self.reads.get() + 1);
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        let Command::Position(q) = command else { return Err(DeviceFault::new(1, "positions only")) };
        self.handle.extend_from_slice(q);
        Ok(())
    }

    fn stop(&mut self) {}
}

struct NoRows;

impl opspace_backend::Sink for NoRows {
    fn row(&mut self, _channel: usize, _time_s: f64, _row: &[f64]) {}
}

/// Compared: the setpoints in a borrowed handle, and those of a scripted robot.
#[test]
fn backend_may_borrow_and_belong_to_one_thread() {
    let position = capabilities(CommandKind::Position);
    let mut handle = Vec::new();
    let reads = Rc::new(Cell::new(0));
    let mut robot =
        Borrowing { capabilities: position.clone(), handle: &mut handle, reads: Rc::clone(&reads) };
    let mut sink = NoRows;
    let control =
        ControlLoop::new(config(position.clone(), gravity_controller(3.0))).expect("parts that fit");
    let mut run = Run::new(control, 0.1, &mut sink);
    drive(&mut robot, &mut run);
    assert_eq!(run.finish(), RunOutcome::Completed);
    let scripted = Scripted::new(position.clone(), at_rest);
    let request = AtomicBool::new(false);
    let record = drive_robot(config(position, gravity_controller(3.0)), 0.1, &request, scripted);
    let setpoints = record.commands().iter().flat_map(|received| match received {
        Received::Positions(q) => q.iter().copied(),
        other => panic!("{other:?}"),
    });
    assert_eq!(handle, setpoints.collect::<Vec<f64>>());
    assert_eq!(reads.get() as usize, record.rows.len());
}

/// Checks at compile time that a loop can be moved to another thread.
#[test]
fn loop_is_send() {
    fn sends<T: Send>(value: T) -> T {
        value
    }
    let control = ControlLoop::new(config(capabilities(CommandKind::Torque), gravity_controller(0.0)));
    assert!(sends(control).is_ok());
}
