//! Recorder between the control thread and the file: a ring buffer of numbers, and the thread that empties it.

use crate::error::LogError;
use crate::file::{File, Gap};
use crate::header::{Channel, Header};
use crate::outcome::OutcomeRecord;
use crate::viewer_receiver::ViewerReceiver;
use rtrb::{Consumer, Producer, RingBuffer};
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Behaviour when the ring is full because the disk is too slow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Wait for space: the simulation pauses. No row is lost, and the bytes of the file depend only on the rows.
    Simulated,
    /// Drop and count the row and record the gap: the robot doesn't wait.
    RealTime,
}

/// Duration of the rows that fit into the ring, s: longer than usual stalls of a disk.
const RING_S: f64 = 2.0;

/// Largest size of the ring, in numbers (512 MB), for any rates.
const RING_MAX: f64 = 64e6;

/// Length of a row's prefix in the ring: channel and time.
const PREFIX: usize = 2;

/// Length of a [`Gap`] in the ring: first time, last time, number of rows. Its channel index is one past the last
/// channel.
const GAP: usize = 3;

/// Sleep of the writer's thread when there is nothing to write: a small part of [`RING_S`].
const POLL: Duration = Duration::from_millis(2);

/// Sleep of a simulation when the ring is full.
const WAIT: Duration = Duration::from_micros(200);

/// Time without new rows after which a real-time run writes the open chunk.
const STILL: Duration = Duration::from_secs(1);

/// Recorder that the control thread passes its rows to. Drop it when the run is over.
#[derive(Debug)]
pub struct Recorder {
    ring: Producer<f64>,
    widths: Vec<usize>,
    pace: Pace,
    /// Rows dropped since the last recorded row.
    gap: Gap,
    dropped: Arc<AtomicU64>,
}

/// Handle of the writer's thread. Call [`finish`](Self::finish); dropping it finishes the file too, but reports no
/// error.
#[derive(Debug)]
pub struct Writer<W> {
    thread: Option<JoinHandle<Result<(WriteStats, W), LogError>>>,
    stop: Arc<AtomicBool>,
    outcome: Arc<Mutex<Option<OutcomeRecord>>>,
}

/// Numbers of rows written and dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
#[non_exhaustive]
pub struct WriteStats {
    /// Number of rows in the file.
    pub records: u64,
    /// Number of rows dropped because the ring was full. The gaps are recorded in the file.
    pub dropped: u64,
}

/// Begins a log: writes the header and starts the thread that writes the rows.
///
/// # Errors
/// If two channels have the same name, the model doesn't fit the rows, or the sink fails.
pub fn record<W: Write + Send + 'static>(
    sink: W,
    header: Header,
    channels: Vec<Channel>,
    pace: Pace,
) -> Result<(Recorder, Writer<W>), LogError> {
    record_with(sink, header, channels, pace, Vec::new())
}

/// Begins a log as [`record`] does. `receivers` get the messages for viewers and the rows, in the thread that writes them.
///
/// # Errors
/// As [`record`].
pub fn record_with<W: Write + Send + 'static>(
    sink: W,
    header: Header,
    channels: Vec<Channel>,
    pace: Pace,
    receivers: Vec<Box<dyn ViewerReceiver>>,
) -> Result<(Recorder, Writer<W>), LogError> {
    let mut names = BTreeSet::new();
    if let Some(c) = channels.iter().find(|c| !names.insert(c.layout.channel.as_str())) {
        return Err(LogError::DuplicateChannel { name: c.layout.channel.clone() });
    }
    let file = File::create(sink, header, &channels, receivers)?;
    let (producer, consumer) = RingBuffer::new(ring_size(&channels));
    let widths: Vec<usize> = channels.iter().map(|c| c.layout.width()).collect();
    let dropped = Arc::new(AtomicU64::new(0));
    let stop = Arc::new(AtomicBool::new(false));
    let outcome = Arc::default();
    let drain = Drain {
        ring: consumer,
        row: vec![0.0; widths.iter().copied().max().unwrap_or(0).max(GAP)],
        widths: widths.clone(),
        file,
        records: 0,
        outcome: Arc::clone(&outcome),
    };
    let (seen, lost) = (Arc::clone(&stop), Arc::clone(&dropped));
    let thread = thread::Builder::new()
        .name("opspace-log".to_owned())
        .spawn(move || drain.run(pace, &seen, &lost))
        .map_err(LogError::Write)?;
    let recorder = Recorder { ring: producer, widths, pace, gap: Gap::default(), dropped };
    Ok((recorder, Writer { thread: Some(thread), stop, outcome }))
}

/// Size of the ring in numbers: at least two of the longest rows and a gap.
fn ring_size(channels: &[Channel]) -> usize {
    let per_second: f64 = channels.iter().map(|c| (PREFIX + c.layout.width()) as f64 * c.rate_hz).sum();
    let widest = channels.iter().map(|c| c.layout.width()).max().unwrap_or(0);
    // The cast converts negative numbers and NaN to 0.
    let asked = (per_second * RING_S).min(RING_MAX) as usize;
    asked.max(2 * (PREFIX + widest) + PREFIX + GAP)
}

impl Recorder {
    /// Records a row of the channel with that index (in the order given to [`record`]) at `time_s` (s) on the robot's
    /// clock. Allocates, locks and formats nothing. If the ring is full, a real-time run drops the row, and a simulated
    /// run waits here; to avoid this wait, call [`wait_for_space`](Self::wait_for_space) between control cycles.
    ///
    /// # Panics
    /// If there is no such channel or the row is not as long as its layout.
    pub fn push(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        assert_eq!(row.len(), self.widths[channel], "a row of channel {channel} is as long as its layout");
        match self.pace {
            Pace::Simulated => {
                while !self.put(channel, time_s, row) {
                    if self.ring.is_abandoned() {
                        self.dropped.fetch_add(1, Ordering::Relaxed);
                        return;
                    }
                    thread::sleep(WAIT);
                }
            }
            Pace::RealTime => self.put_or_drop(channel, time_s, row),
        }
    }

    /// Waits until half the ring is free, for use between the control cycles of a simulated run. Returns at once in a
    /// real-time run.
    pub fn wait_for_space(&mut self) {
        let half = self.ring.buffer().capacity() / 2;
        while self.pace == Pace::Simulated && self.ring.slots() < half && !self.ring.is_abandoned() {
            thread::sleep(WAIT);
        }
    }

    /// Number of rows dropped so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// True if rows are still written; false after the sink failed or the writer finished.
    #[must_use]
    pub fn is_writing(&self) -> bool {
        !self.ring.is_abandoned()
    }

    fn put_or_drop(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        if self.gap.records > 0 {
            // Recording continues only when a quarter of the ring is free: one long gap instead of many short ones.
            let room = (self.ring.buffer().capacity() / 4).max(2 * PREFIX + GAP + row.len());
            if self.ring.slots() < room || !self.put_gap() {
                return self.drop_row(time_s);
            }
        }
        if !self.put(channel, time_s, row) {
            self.drop_row(time_s);
        }
    }

    fn drop_row(&mut self, time_s: f64) {
        if self.gap.records == 0 {
            self.gap.from_s = time_s;
        }
        self.gap.to_s = time_s;
        self.gap.records += 1;
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }

    /// Puts the gap into the ring, if there is space.
    fn put_gap(&mut self) -> bool {
        let Gap { records, from_s, to_s } = self.gap;
        let put = self.put(self.widths.len(), from_s, &[from_s, to_s, records as f64]);
        if put {
            self.gap = Gap::default();
        }
        put
    }

    /// Puts a record into the ring, completely or not at all.
    fn put(&mut self, channel: usize, time_s: f64, row: &[f64]) -> bool {
        let Ok(chunk) = self.ring.write_chunk_uninit(PREFIX + row.len()) else {
            return false;
        };
        chunk.fill_from_iter([channel as f64, time_s].into_iter().chain(row.iter().copied()));
        true
    }
}

impl Drop for Recorder {
    /// Records the last gap before the ring is closed.
    fn drop(&mut self) {
        while self.gap.records > 0 && !self.put_gap() && !self.ring.is_abandoned() {
            thread::sleep(WAIT);
        }
    }
}

impl<W> Writer<W> {
    /// Writes the remaining rows and the footer, and returns the sink. Drop the [`Recorder`] first: rows pushed
    /// afterwards are lost.
    ///
    /// # Errors
    /// If the sink fails, now or during the run.
    pub fn finish(mut self) -> Result<(WriteStats, W), LogError> {
        self.join_writer()
    }

    /// Finishes the log as [`finish`](Self::finish) does, with the outcome of the run as a record at its end.
    ///
    /// # Errors
    /// Errors of [`finish`](Self::finish).
    pub fn finish_with(mut self, outcome: OutcomeRecord) -> Result<(WriteStats, W), LogError> {
        // If the lock is poisoned, the writer panicked; joining it reports this.
        if let Ok(mut slot) = self.outcome.lock() {
            *slot = Some(outcome);
        }
        self.join_writer()
    }

    fn join_writer(&mut self) -> Result<(WriteStats, W), LogError> {
        match self.join() {
            Some(Ok(result)) => result,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Err(LogError::Write(io::Error::other("the log is already finished"))),
        }
    }

    fn join(&mut self) -> Option<thread::Result<Result<(WriteStats, W), LogError>>> {
        let thread = self.thread.take()?;
        self.stop.store(true, Ordering::Release);
        thread.thread().unpark();
        Some(thread.join())
    }
}

impl<W> Drop for Writer<W> {
    fn drop(&mut self) {
        self.join();
    }
}

/// State of the writer's thread: the consumer of the ring, and the file.
struct Drain<W: Write> {
    ring: Consumer<f64>,
    widths: Vec<usize>,
    row: Vec<f64>,
    file: File<W>,
    records: u64,
    /// Outcome of the run, set before the stop if it is known.
    outcome: Arc<Mutex<Option<OutcomeRecord>>>,
}

impl<W: Write> Drain<W> {
    fn run(
        mut self,
        pace: Pace,
        stop: &AtomicBool,
        dropped: &AtomicU64,
    ) -> Result<(WriteStats, W), LogError> {
        let mut moved = Instant::now();
        // Only the writer's handle ends the log: it sets the outcome after the recorder is gone.
        loop {
            // Read before the ring is emptied, so that rows pushed before the stop are written.
            let last = stop.load(Ordering::Acquire);
            if self.empty()? {
                moved = Instant::now();
            } else if !last {
                if pace == Pace::RealTime && moved.elapsed() >= STILL {
                    self.file.close_chunk()?;
                }
                thread::park_timeout(POLL);
            }
            if last {
                break;
            }
        }
        let dropped = dropped.load(Ordering::Relaxed);
        let written = WriteStats { records: self.records, dropped };
        let outcome = self.outcome.lock().ok().and_then(|mut slot| slot.take());
        Ok((written, self.file.finish(dropped, outcome.as_ref())?))
    }

    /// Writes the present content of the ring; returns true if it was not empty.
    fn empty(&mut self) -> Result<bool, LogError> {
        let mut left = self.ring.slots();
        let any = left > 0;
        while left > 0 {
            let mut prefix = [0.0; PREFIX];
            // Records are put into the ring completely, so that each one can be read completely.
            let whole = "a record in the ring is whole";
            self.ring.pop_entire_slice(&mut prefix).expect(whole);
            let channel = prefix[0] as usize;
            let width = self.widths.get(channel).copied().unwrap_or(GAP);
            let row = &mut self.row[..width];
            self.ring.pop_entire_slice(row).expect(whole);
            left -= PREFIX + width;
            if channel < self.widths.len() {
                self.file.row(channel, prefix[1], row)?;
                self.records += 1;
            } else {
                self.file.gap(Gap { from_s: row[0], to_s: row[1], records: row[2] as u64 })?;
            }
        }
        Ok(any)
    }
}
