//! Calls of a driver: a panic is a fault of the device, and so is a sample that comes late by the computer's clock.

use opspace_backend::{Backend, Capabilities, Command, DeviceFault, Sample, World};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

/// Longest time by which the computer's clock may pass more than the robot's clock between two samples of a real robot, s.
/// It is longer than a computer without real-time scheduling delays a program, so that only old samples exceed it.
pub const LATEST_S: f64 = 0.25;

/// Code of the faults that are found here, not by the device.
const CODE: u32 = 0;

const READ_PANICKED: &str = "its driver panicked in `read`; the message was printed to standard error";
const WRITE_PANICKED: &str = "its driver panicked in `write`; the message was printed to standard error";
const STOP_PANICKED: &str = "its driver panicked in `stop`; the message was printed to standard error";
const STOP_PANICKED_TWICE: &str =
    "its driver panicked in `stop`, and again when it was repeated: the robot may still move";
const LATE: &str = "by the computer's clock, a sample came more than 0.25 s later than the robot's clock says: `read` blocked, or the sample is old";

/// Calls of one robot's driver. Allocates nothing unless a call panics.
pub(crate) struct DriverCalls {
    is_real: bool,
    /// Time of the last sample on the computer's clock, and on the robot's clock, s.
    last: Option<(Instant, f64)>,
    panicked: bool,
}

impl DriverCalls {
    pub(crate) fn new(capabilities: &Capabilities) -> Self {
        Self { is_real: capabilities.world == World::Real, last: None, panicked: false }
    }

    /// True if a call panicked: nothing but the robot's stop is to be called.
    pub(crate) fn panicked(&self) -> bool {
        self.panicked
    }

    /// Reads a sample.
    pub(crate) fn read(&mut self, backend: &mut dyn Backend, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.call(READ_PANICKED, || backend.read(sample))?;
        if self.is_real { self.check_lateness(sample.time_s) } else { Ok(()) }
    }

    /// Writes a command.
    pub(crate) fn write(
        &mut self,
        backend: &mut dyn Backend,
        command: Command<'_>,
    ) -> Result<(), DeviceFault> {
        self.call(WRITE_PANICKED, || backend.write(command))
    }

    fn call(
        &mut self,
        words: &'static str,
        body: impl FnOnce() -> Result<(), DeviceFault>,
    ) -> Result<(), DeviceFault> {
        catch_unwind(AssertUnwindSafe(body)).unwrap_or_else(|_| {
            self.panicked = true;
            Err(DeviceFault::new(CODE, words))
        })
    }

    /// Compares both clocks since the last sample, which came at `time_s` (s) on the robot's clock.
    fn check_lateness(&mut self, time_s: f64) -> Result<(), DeviceFault> {
        let now = Instant::now();
        let Some((then, then_s)) = self.last.replace((now, time_s)) else { return Ok(()) };
        let advanced_s = time_s - then_s;
        let late_s = (now - then).as_secs_f64() - advanced_s;
        // A clock that does not advance, or is not finite, is a fault of its own.
        if advanced_s > 0.0 && late_s > LATEST_S { Err(DeviceFault::new(CODE, LATE)) } else { Ok(()) }
    }
}

/// Reads a sample before the run; a panic is a fault.
///
/// # Errors
/// The fault of the device, or the panic.
pub fn read_once(backend: &mut dyn Backend, sample: &mut Sample) -> Result<(), DeviceFault> {
    DriverCalls::new(backend.capabilities()).read(backend, sample)
}

/// Calls the robot's own stop, and once more if it panics.
///
/// # Errors
/// The panic.
pub fn stop(backend: &mut dyn Backend) -> Result<(), DeviceFault> {
    let mut panics = || catch_unwind(AssertUnwindSafe(|| backend.stop())).is_err();
    if !panics() {
        return Ok(());
    }
    let words = if panics() { STOP_PANICKED_TWICE } else { STOP_PANICKED };
    Err(DeviceFault::new(CODE, words))
}
