//! A robot whose handle borrows data and is bound to one thread, like the handles of some vendors' libraries: neither
//! `Send` nor `'static` is required.
//!
//! `cargo run --release -p opspace --example borrowed_handle` writes to `runs/borrowed_handle`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::backend::{Backend, Capabilities, Command, DeviceFault, GroundTruth, Sample};
use opspace::experiment::{Experiment, Files, Progress};
use opspace::sim::SimulatedArm;
use std::cell::Cell;
use std::rc::Rc;

/// Vendor's library, which is owned by a function's frame.
struct Library {
    arm: SimulatedArm,
    writes: Rc<Cell<u64>>,
}

/// Handle that borrows the library. It is not `Send`, because its counter is not.
struct Handle<'a> {
    library: &'a mut Library,
}

impl Backend for Handle<'_> {
    fn capabilities(&self) -> &Capabilities {
        self.library.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.library.arm.read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.library.writes.set(self.library.writes.get() + 1);
        self.library.arm.write(command)
    }

    fn stop(&mut self) {
        self.library.arm.stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        self.library.arm.ground_truth()
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let task = "tasks/compliant-x.toml".as_ref();
    let experiment = Experiment::load(Files::Disk, task, None, Default::default(), &[])?;
    let writes = Rc::new(Cell::new(0));
    let mut library = Library { arm: experiment.simulated_arm()?, writes: Rc::clone(&writes) };
    common::record("borrowed_handle", &experiment, |log| {
        experiment.run_on(&mut Handle { library: &mut library }, log, &Progress::default())
    })?;
    println!("the handle wrote {} setpoints", writes.get());
    Ok(())
}
