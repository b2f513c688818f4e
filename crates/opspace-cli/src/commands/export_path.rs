//! `opspace log export --path`: the measured path of a frame, in the form of `reference.recorded`.

use crate::console::{Exit, Failure};
use opspace_backend::signal_names::{ORIENTATION, PHASE, POSITION, TICK_CHANNEL};
use opspace_log::{LogFile, Recording};
use opspace_loop::Phase;
use std::io::{self, Write};

/// Path of a task's controlled frame, in world axes, sampled at equal intervals.
pub struct PathExport {
    /// Names of the signals of position and orientation.
    signals: [String; 2],
    every_s: f64,
}

impl PathExport {
    /// Prepares the export of a task's path.
    ///
    /// # Errors
    /// If the log has no controlled frame of this task, or the interval isn't positive.
    pub fn new(log: &LogFile, task: &str, every_s: f64) -> Result<Self, Failure> {
        let bad = |text: String| Failure::Other(text, Exit::Bad);
        if !(every_s > 0.0 && every_s.is_finite()) {
            return Err(bad(format!("--every-s: expected a time above 0 s, got {every_s}")));
        }
        let signals = [POSITION, ORIENTATION].map(|signal| format!("{task}.{signal}"));
        let tick = log.recording().channel(TICK_CHANNEL);
        let names = || tick.into_iter().flat_map(|tick| &tick.layout.signals).map(|signal| &signal.name);
        if signals.iter().all(|signal| names().any(|name| name == signal)) {
            return Ok(Self { signals, every_s });
        }
        let known: Vec<&str> =
            names().filter_map(|name| name.strip_suffix(&format!(".{ORIENTATION}"))).collect();
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        Err(bad(format!("--path: the log has no frame of a task '{task}'; tasks with a frame: {known}")))
    }

    /// Writes the path, from the first to the last cycle in which the task was controlled; times count from the first one.
    pub fn write(&self, log: &LogFile, mut sink: impl Write) -> io::Result<()> {
        writeln!(sink, "time_s,x_m,y_m,z_m,qw,qx,qy,qz")?;
        let (mut written, mut begin_s, mut next_s, mut last) = (Ok(()), None, f64::NEG_INFINITY, None);
        log.for_each_segment(&mut |segment, _| {
            for sample in self.samples(segment) {
                let time_s = sample[0] - *begin_s.get_or_insert(sample[0]);
                let is_due = time_s >= next_s;
                last = (!is_due).then_some((time_s, sample));
                if is_due && written.is_ok() {
                    written = write_sample(&mut sink, time_s, &sample);
                    next_s = self.every_s * ((time_s / self.every_s + 0.5).floor() + 1.0) - 1e-6;
                }
            }
        })
        .map_err(io::Error::other)?;
        written?;
        if let Some((time_s, sample)) = last {
            write_sample(&mut sink, time_s, &sample)?;
        }
        sink.flush()
    }

    /// Times, positions and quaternions of a part of the log, where they are known.
    fn samples(&self, segment: &Recording) -> Vec<[f64; 8]> {
        let Some(tick) = segment.channel(TICK_CHANNEL) else { return Vec::new() };
        let [position, orientation] = self.signals.each_ref().map(|name| tick.signal(name));
        let (Some(position), Some(orientation), Some(phase)) = (position, orientation, tick.signal(PHASE))
        else {
            return Vec::new();
        };
        let controlled = [Phase::Control.code(), Phase::Resuming.code()];
        let sample = |k: usize| {
            let (p, q) = (position.row(k), orientation.row(k));
            [tick.time_s[k], p[0], p[1], p[2], q[0], q[1], q[2], q[3]]
        };
        let rows = (0..tick.len()).filter(|&k| controlled.contains(&phase.row(k)[0]));
        rows.map(sample).filter(|sample| sample.iter().all(|value| value.is_finite())).collect()
    }
}

fn write_sample(sink: &mut impl Write, time_s: f64, sample: &[f64; 8]) -> io::Result<()> {
    let [_, x, y, z, qw, qx, qy, qz] = sample;
    writeln!(sink, "{time_s:.6},{x:.9},{y:.9},{z:.9},{qw:.12},{qx:.12},{qy:.12},{qz:.12}")
}
