//! Recorder from the control thread to the file: a ring of numbers and the thread that empties it.

use crate::error::LogError;
use crate::file::{File, Gap};
use crate::header::{Channel, Header};
use crate::outcome::OutcomeRecord;
use rtrb::{Consumer, Producer, RingBuffer};
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Behaviour when the disk can't keep up and the ring is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Wait until there is room: the simulation pauses. No row is lost, and the file's bytes depend on the rows
    /// alone.
    Simulated,
    /// Drop the row, count it and note the gap: the robot doesn't wait.
    RealTime,
}

/// Duration of the rows that the ring holds, s: longer than a disk usually stalls.
const RING_S: f64 = 2.0;

/// Largest size of the ring, numbers (512 MB), whatever the rates.
const RING_MAX: f64 = 64e6;

/// Length of the prefix of a row in the ring: channel and time.
const PREFIX: usize = 2;

/// Length of a [`Gap`] in the ring, where it stands as a channel after the last: first, last, number of rows.
const GAP: usize = 3;

/// Sleep of the writer's thread when there is nothing to write: a small part of [`RING_S`].
const POLL: Duration = Duration::from_millis(2);

/// Sleep of a simulation when the ring is full.
const WAIT: Duration = Duration::from_micros(200);

/// Time without new rows after which a real-time run writes what it has.
const STILL: Duration = Duration::from_secs(1);

/// Recorder of the control thread, which takes rows. Drop it when the run is over.
#[derive(Debug)]
pub struct Recorder {
    ring: Producer<f64>,
    widths: Vec<usize>,
    pace: Pace,
    /// Rows dropped since the last recorded one.
    gap: Gap,
    dropped: Arc<AtomicU64>,
}

/// Handle of the writer's thread. [`finish`](Self::finish) it; dropping it finishes the file too, but reports no error.
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
    /// Number of rows dropped because the ring was full; the gaps are in the file.
    pub dropped: u64,
}

/// Begins a log: writes the header and starts the thread that writes the rows.
///
/// # Errors
/// If two channels have one name, if a model doesn't fit the rows, or if the sink fails.
pub fn record<W: Write + Send + 'static>(
    sink: W,
    header: Header,
    channels: Vec<Channel>,
    pace: Pace,
) -> Result<(Recorder, Writer<W>), LogError> {
    let mut names = BTreeSet::new();
    if let Some(c) = channels.iter().find(|c| !names.insert(c.layout.channel.as_str())) {
        return Err(LogError::DuplicateChannel { name: c.layout.channel.clone() });
    }
    let file = File::create(sink, header, &channels)?;
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

/// Size of the ring, numbers: at least two of the longest rows and a gap.
fn ring_size(channels: &[Channel]) -> usize {
    let per_second: f64 = channels.iter().map(|c| (PREFIX + c.layout.width()) as f64 * c.rate_hz).sum();
    let widest = channels.iter().map(|c| c.layout.width()).max().unwrap_or(0);
    // The cast takes what is negative or NaN to 0.
    let asked = (per_second * RING_S).min(RING_MAX) as usize;
    asked.max(2 * (PREFIX + widest) + PREFIX + GAP)
}

impl Recorder {
    /// Records a row of the channel with that index (in the order given to [`record`]) at `time_s` on the
    /// robot's clock. Allocates, locks and formats nothing. With a full ring a simulated run waits here (call
    /// [`wait_for_space`](Self::wait_for_space) between the control cycles so that it doesn't), a real-time run
    /// drops the row.
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

    /// Waits, between the control cycles of a simulated run, until half the ring is free. A real-time run doesn't wait.
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

    /// True if rows are still written: false after the sink failed, or the writer was finished.
    #[must_use]
    pub fn is_writing(&self) -> bool {
        !self.ring.is_abandoned()
    }

    fn put_or_drop(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        if self.gap.records > 0 {
            // One long gap rather than many short ones: a quarter of the ring must be free to go on.
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

    /// Records the gap, if there is room.
    fn put_gap(&mut self) -> bool {
        let Gap { records, from_s, to_s } = self.gap;
        let put = self.put(self.widths.len(), from_s, &[from_s, to_s, records as f64]);
        if put {
            self.gap = Gap::default();
        }
        put
    }

    /// Puts a whole record into the ring, or nothing.
    fn put(&mut self, channel: usize, time_s: f64, row: &[f64]) -> bool {
        let Ok(chunk) = self.ring.write_chunk_uninit(PREFIX + row.len()) else {
            return false;
        };
        chunk.fill_from_iter([channel as f64, time_s].into_iter().chain(row.iter().copied()));
        true
    }
}

impl Drop for Recorder {
    /// Records the last gap as well.
    fn drop(&mut self) {
        while self.gap.records > 0 && !self.put_gap() && !self.ring.is_abandoned() {
            thread::sleep(WAIT);
        }
    }
}

impl<W> Writer<W> {
    /// Writes what is still in the ring and the footer, and returns the sink. Drop the [`Recorder`] first:
    /// what it pushes afterwards is lost.
    ///
    /// # Errors
    /// If the sink fails, now or during the run.
    pub fn finish(mut self) -> Result<(WriteStats, W), LogError> {
        self.join_writer()
    }

    /// Finishes the log as [`finish`](Self::finish) does, with the outcome of the run as a record at its end.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn finish_with(mut self, outcome: OutcomeRecord) -> Result<(WriteStats, W), LogError> {
        // A poisoned lock: the writer panicked, which joining it tells.
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

/// State of the writer's thread: the reading end of the ring, and the file.
struct Drain<W: Write> {
    ring: Consumer<f64>,
    widths: Vec<usize>,
    row: Vec<f64>,
    file: File<W>,
    records: u64,
    /// Outcome, set before the stop by whoever knows how the run ended.
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
        loop {
            // Asked before the ring is emptied: what was pushed before the stop is written.
            let last = stop.load(Ordering::Acquire) || self.ring.is_abandoned();
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

    /// Writes the present content of the ring; returns true if there was any.
    fn empty(&mut self) -> Result<bool, LogError> {
        let mut left = self.ring.slots();
        let any = left > 0;
        while left > 0 {
            let mut prefix = [0.0; PREFIX];
            // Records are put whole, so that what begins in the ring also ends in it.
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
