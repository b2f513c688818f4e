//! Driver of an arm in real time, whose faults are chosen in `[driver]`: those of the device, and those of its own code.

use opspace_backend::{
    Backend, Capabilities, Command, DeviceFault, Driver, DriverError, RemoteStop, Sample, Settings,
};
use std::fs::File;
use std::io::Write;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Message of the panics that it causes.
const PANIC: &str = "a panic of the driver";

/// Driver of the arm. Its keys are fields of [`Faults`], and `calls`, the path of a file with a line for each call of `stop`,
/// of the remote stop, and for the end. Beside it, `calls.times` has the time of each on the computer's clock.
pub struct FaultyDriver;

/// Faults, each with the default that is none.
struct Faults {
    /// Place of a panic: `open`, `read`, `write`, `stop`, `every stop` or `close`.
    panic: String,
    /// Number of the read in which it happens, or from which `write` panics; 1 is the one before the run.
    at: f64,
    /// Time between two samples on the robot's clock, in periods.
    spacing: f64,
    /// Time on the robot's clock in read `at`, s.
    time_s: Option<f64>,
    /// Period that the arm declares, s.
    declared_s: f64,
    /// Time for which read `at` blocks, s.
    blocks_s: f64,
    /// True if read `at` and all later ones fail: the device is dead.
    dead: bool,
    /// True if another thread can stop the arm and end the block.
    remote: bool,
}

impl Driver for FaultyDriver {
    fn name(&self) -> &str {
        "faulty"
    }

    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError> {
        let number = |key, default| settings.number(key).unwrap_or(default);
        // A setting is a finite number.
        let parsed = |key| settings.text(key).ok().and_then(|text| text.parse().ok());
        let faults = Faults {
            panic: settings.text("panic").unwrap_or_default().to_owned(),
            at: number("at", f64::NAN),
            spacing: number("spacing", 1.0),
            time_s: parsed("time_s"),
            declared_s: parsed("declared_s").unwrap_or(settings.period_s),
            blocks_s: number("blocks_s", 0.0),
            dead: settings.flag("dead")?,
            remote: settings.flag("remote")?,
        };
        let panic = faults.panic.clone();
        assert!(panic != "open", "{PANIC}");
        let calls = settings.text("calls")?;
        let open = |path: &str| File::options().append(true).create(true).open(path);
        let calls = open(calls).and_then(|file| Ok(Calls { file, times: open(&format!("{calls}.times"))? }));
        let calls = calls.map_err(|error| DriverError::new(error.to_string()))?;
        let joints = settings.joints.clone();
        let n = joints.len();
        let (unblock, blocked) = channel();
        let mut arm = Arm {
            capabilities: Capabilities::new(joints, settings.command, faults.declared_s)
                .with_force_sensors(settings.force_sensors.clone()),
            faults,
            calls,
            blocked,
            unblock,
            reads: 0.0,
            began: Instant::now(),
            q: vec![0.0; n],
            stops: 0,
        };
        run(&mut arm);
        assert!(panic != "close", "{PANIC}");
        if settings.flag("error")? { Err(DriverError::new("the arm did not close")) } else { Ok(()) }
    }
}

struct Arm {
    capabilities: Capabilities,
    faults: Faults,
    calls: Calls,
    blocked: Receiver<()>,
    unblock: Sender<()>,
    reads: f64,
    began: Instant,
    q: Vec<f64>,
    stops: u32,
}

/// File of the calls, and file of their times since 1970, s.
struct Calls {
    file: File,
    times: File,
}

impl Calls {
    fn note(&self, call: &str) {
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).expect("a clock").as_secs_f64();
        writeln!(&self.times, "{call} {now_s:.6}").expect("a file of times");
        writeln!(&self.file, "{call}").expect("a file of calls");
    }
}

impl Backend for Arm {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.reads += 1.0;
        let is_at = self.reads >= self.faults.at && self.reads < self.faults.at + 1.0;
        assert!(!(is_at && self.faults.panic == "read"), "{PANIC}");
        if is_at && self.faults.blocks_s > 0.0 {
            self.calls.note("blocked");
            if self.blocked.recv_timeout(Duration::from_secs_f64(self.faults.blocks_s)).is_ok() {
                return Err(DeviceFault::new(5, "the arm was stopped from another thread"));
            }
        }
        if self.faults.dead && self.reads >= self.faults.at {
            self.calls.note("failed");
            return Err(DeviceFault::new(6, "the arm does not answer"));
        }
        let due = Duration::from_secs_f64(self.reads / 1000.0);
        sleep(due.saturating_sub(self.began.elapsed()));
        let time_s = self.reads * self.faults.spacing / 1000.0;
        sample.time_s = self.faults.time_s.filter(|_| is_at).unwrap_or(time_s);
        sample.q.copy_from_slice(&self.q);
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        assert!(!(self.reads >= self.faults.at && self.faults.panic == "write"), "{PANIC}");
        if let Command::Position(q) = command {
            self.q.copy_from_slice(q);
        }
        Ok(())
    }

    fn stop(&mut self) {
        self.calls.note("stop");
        self.stops += 1;
        let panics = match self.faults.panic.as_str() {
            "stop" => self.stops == 1,
            "every stop" => true,
            _ => false,
        };
        assert!(!panics, "{PANIC}");
    }

    fn remote_stop(&self) -> Option<RemoteStop> {
        let copy = |file: &File| file.try_clone().expect("a file of calls");
        let calls = Calls { file: copy(&self.calls.file), times: copy(&self.calls.times) };
        let unblock = self.unblock.clone();
        self.faults.remote.then(|| -> RemoteStop {
            Box::new(move || {
                calls.note("remote stop");
                unblock.send(()).expect("the arm is open");
            })
        })
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        self.calls.note("closed");
    }
}
