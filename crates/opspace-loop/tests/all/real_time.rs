//! Tests of real-time scheduling and of the times in the channel `timing`.

use crate::common::{Scripted, at_rest, capabilities, config, gravity_controller};
use opspace_backend::{Backend, Capabilities, Command, CommandKind, DeviceFault, Sample, Sink, TIMING};
use opspace_loop::{ControlLoop, Run, drive};
use std::thread;
use std::time::{Duration, Instant};

/// Time that a command takes to be written.
const WRITING: Duration = Duration::from_millis(1);

/// Robot whose commands take a while to be written.
struct Slow<B>(B);

impl<B: Backend> Backend for Slow<B> {
    fn capabilities(&self) -> &Capabilities {
        self.0.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.0.read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        thread::sleep(WRITING);
        self.0.write(command)
    }

    fn stop(&mut self) {
        self.0.stop();
    }
}

#[derive(Default)]
struct Timings(Vec<[f64; 3]>);

impl Sink for Timings {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel == TIMING {
            self.0.push(row.try_into().expect("three signals"));
        }
    }
}

/// Compared: the rows of a run whose commands take 1 ms to be written, with that time and with the duration of the run.
#[test]
fn response_contains_writing_and_intervals_add_up() {
    let kind = CommandKind::Torque;
    let control =
        ControlLoop::new(config(capabilities(kind), gravity_controller(3.0))).expect("parts that fit");
    let mut rows = Timings::default();
    let began = Instant::now();
    let mut run = Run::new(control, 0.05, &mut rows);
    drive(&mut Slow(Scripted::new(capabilities(kind), at_rest)), &mut run);
    drop(run);
    let total_ns = began.elapsed().as_nanos() as f64;
    assert!(rows.0.len() >= 50 && rows.0[0][1].is_nan() && rows.0[0][2] >= 0.0);
    let intervals_ns: f64 = rows.0[1..].iter().map(|row| row[1]).sum();
    assert!(intervals_ns > 0.0 && intervals_ns <= total_ns, "{intervals_ns} of {total_ns}");
    let written: Vec<&[f64; 3]> = rows.0.iter().filter(|row| row[2] >= WRITING.as_nanos() as f64).collect();
    assert!(written.len() >= 40, "{} commands", written.len());
    for [tick_ns, _, response_ns] in &rows.0 {
        assert!(tick_ns <= response_ns);
    }
}

#[cfg(target_os = "linux")]
mod scheduling {
    use opspace_loop::{RealTime, RealTimeMode, RealTimeParameters};
    use std::fs;

    /// Real-time priority and policy of this thread, as the kernel tells them.
    fn scheduling() -> [String; 2] {
        let stat = fs::read_to_string("/proc/thread-self/stat").expect("it is there");
        let (_, fields) = stat.rsplit_once(") ").expect("the name of the thread");
        // Fields 40 and 41; the first one here is field 3.
        [37, 38].map(|place| fields.split(' ').nth(place).expect("a field").to_owned())
    }

    fn locked_kb() -> u64 {
        let status = fs::read_to_string("/proc/self/status").expect("it is there");
        let line = status.lines().find_map(|line| line.strip_prefix("VmLck:")).expect("a line");
        line.split_whitespace().next().and_then(|number| number.parse().ok()).expect("a number")
    }

    /// Compared: what is said to be granted, and what the kernel tells meanwhile and afterwards.
    #[test]
    fn what_is_granted_is_what_the_kernel_tells_until_the_end() {
        let before = scheduling();
        let real_time = RealTime::enter(RealTimeParameters::default().with_priority(7));
        let text = real_time.text();
        match text.contains("SCHED_FIFO with priority 7") {
            true => assert_eq!(scheduling(), ["7", "1"]),
            false => assert!(text.contains("no SCHED_FIFO (") && scheduling() == before, "{text}"),
        }
        assert_eq!(locked_kb() > 0, text.contains("memory locked"), "{text}");
        let is_complete = !text.contains("no SCHED_FIFO") && !text.contains("not locked");
        assert_eq!(real_time.is_complete(), is_complete);
        drop(real_time);
        assert_eq!(scheduling(), before);
    }

    #[test]
    fn nothing_is_asked_for_if_it_is_off() {
        let before = scheduling();
        let real_time = RealTime::enter(RealTimeParameters::default().with_mode(RealTimeMode::Off));
        assert_eq!(scheduling(), before);
        assert!(real_time.is_complete());
    }
}
