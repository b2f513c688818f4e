//! Tests of the recorder: full rings, failing sinks, and pushing without allocation.
#![expect(clippy::unwrap_used, reason = "tests")]

use crate::common::{bits, channels, row};
use opspace_testing::allocation::{Count, allocations, counted};

use foxglove::messages::Log;
use mcap::MessageStream;
use opspace_log::{
    Channel, GAPS, Header, LogError, OutcomeRecord, Pace, Recorder, Recording, Writer, record,
};
use prost::Message;
use std::io::{self, Cursor, Write};
use std::sync::{Arc, Condvar, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// Returns the channel `tick` with the smallest possible ring.
fn tiny() -> Vec<Channel> {
    vec![Channel { rate_hz: 0.0, ..channels().remove(0) }]
}

/// Sink that can be made to block or to fail.
#[derive(Clone, Debug, Default)]
struct Sink {
    bytes: Arc<Mutex<Vec<u8>>>,
    gate: Arc<(Mutex<Gate>, Condvar)>,
    room: Option<usize>,
}

#[derive(Debug, Default)]
struct Gate {
    shut: bool,
    waiting: bool,
}

impl Sink {
    fn shut(&self) {
        self.gate.0.lock().unwrap().shut = true;
    }

    fn open(&self) {
        self.gate.0.lock().unwrap().shut = false;
        self.gate.1.notify_all();
    }

    /// Waits until a write is blocked at the gate.
    fn wait_until_stuck(&self) {
        let stuck = self.gate.1.wait_while(self.gate.0.lock().unwrap(), |gate| !gate.waiting);
        drop(stuck.unwrap());
    }
}

impl Write for Sink {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let mut gate = self.gate.0.lock().unwrap();
        if gate.shut {
            gate.waiting = true;
            self.gate.1.notify_all();
            drop(self.gate.1.wait_while(gate, |gate| gate.shut).unwrap());
        }
        let mut bytes = self.bytes.lock().unwrap();
        if self.room.is_some_and(|room| bytes.len() + data.len() > room) {
            return Err(io::ErrorKind::StorageFull.into());
        }
        bytes.extend_from_slice(data);
        Ok(data.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A writer's thread that has emptied the ring long before the outcome is known still writes the outcome.
#[test]
fn outcome_that_comes_after_the_recorder_is_written() {
    for pace in [Pace::Simulated, Pace::RealTime] {
        let (recorder, writer) = record(Cursor::new(Vec::new()), Header::default(), tiny(), pace).unwrap();
        drop(recorder);
        thread::sleep(Duration::from_millis(30));
        let outcome = OutcomeRecord { interrupted: true, time_s: Some(0.25), ..OutcomeRecord::default() };
        let (_, sink) = writer.finish_with(outcome.clone()).unwrap();
        assert_eq!(OutcomeRecord::of(&Recording::from_bytes(sink.get_ref()).unwrap()), outcome);
    }
}

/// Checks a simulated run with a ring of two rows: every row arrives, in order.
#[test]
fn simulated_run_loses_no_rows() {
    let (mut recorder, writer) =
        record(Cursor::new(Vec::new()), Header::default(), tiny(), Pace::Simulated).unwrap();
    for k in 0..1000 {
        if k % 2 == 0 {
            recorder.wait_for_space();
        }
        recorder.push(0, k as f64, &row(k, 9));
    }
    drop(recorder);
    let (written, sink) = writer.finish().unwrap();
    assert_eq!((written.records, written.dropped), (1000, 0));
    let recording = Recording::from_bytes(sink.get_ref()).unwrap();
    let tick = &recording.channels[0];
    assert_eq!(tick.len(), 1000);
    assert!((0..1000).all(|k| bits(tick.row(k)) == bits(&row(k, 9)) && tick.time_s[k] == k as f64));
}

/// Real-time run whose disk stalls. Rows are one second apart, so that the second row closes a chunk.
struct Stalled {
    sink: Sink,
    recorder: Recorder,
    writer: Writer<Sink>,
    next: usize,
    kept: Vec<f64>,
    dropped: Vec<f64>,
}

impl Stalled {
    /// Returns a run with an empty ring of 20 rows, while the writer waits at the sink's gate.
    fn new() -> Self {
        let sink = Sink::default();
        // Twenty rows: 10 Hz times the ring's duration of two seconds.
        let channels = vec![Channel { rate_hz: 10.0, ..channels().remove(0) }];
        let (recorder, writer) = record(sink.clone(), Header::default(), channels, Pace::RealTime).unwrap();
        let mut run = Self { sink, recorder, writer, next: 0, kept: vec![], dropped: vec![] };
        run.sink.shut();
        assert!(run.push() && run.push());
        run.sink.wait_until_stuck();
        run
    }

    /// Pushes a row; returns true if it was kept.
    fn push(&mut self) -> bool {
        let before = self.recorder.dropped();
        let time = self.next as f64;
        self.recorder.push(0, time, &row(self.next, 9));
        self.next += 1;
        let kept = self.recorder.dropped() == before;
        if kept {
            self.kept.push(time)
        } else {
            self.dropped.push(time)
        }
        kept
    }

    /// Ends the run. Compared: kept rows and rows in the file; dropped rows and the counts, the gap in the metadata and
    /// the warning in `/log`.
    fn check(self) {
        let Self { sink, recorder, writer, kept, dropped, .. } = self;
        // Recording the last gap waits for space.
        let ending = thread::spawn(move || drop(recorder));
        sink.open();
        ending.join().unwrap();
        let (written, _) = writer.finish().unwrap();
        assert_eq!((written.records, written.dropped), (kept.len() as u64, dropped.len() as u64));

        let bytes = sink.bytes.lock().unwrap();
        let recording = Recording::from_bytes(&bytes).unwrap();
        assert_eq!(recording.damage, None, "a gap is no damage");
        assert_eq!(recording.dropped(), dropped.len() as u64);
        let tick = &recording.channels[0];
        assert_eq!(tick.time_s, kept);
        assert!(kept.iter().enumerate().all(|(k, &t)| bits(tick.row(k)) == bits(&row(t as usize, 9))));

        let (from, to) = (dropped[0], dropped[dropped.len() - 1]);
        let gaps = &recording.metadata(GAPS).unwrap()["gaps"];
        let expected = serde_json::json!([{ "from_s": from, "to_s": to, "records": dropped.len() }]);
        assert_eq!(serde_json::from_str::<serde_json::Value>(gaps).unwrap(), expected);
        let warnings: Vec<_> = MessageStream::new(&bytes)
            .unwrap()
            .map(Result::unwrap)
            .filter(|m| m.channel.topic == "/log")
            .map(|m| Log::decode(&*m.data).unwrap().message)
            .collect();
        let text = format!("{} records were dropped from t = {from} s to {to} s", dropped.len());
        assert_eq!(warnings, [text]);
    }
}

/// Checks that rows beyond the ring's capacity are dropped and counted until the disk resumes.
#[test]
fn full_ring_drops_and_counts_rows() {
    let mut run = Stalled::new();
    let kept: Vec<bool> = (0..25).map(|_| run.push()).collect();
    assert_eq!(kept, [[true; 20].as_slice(), &[false; 5]].concat());
    run.sink.open();
    while !run.push() {
        thread::sleep(Duration::from_millis(1));
    }
    run.check();
}

/// Checks that a gap that lasts to the end of the run is reported like any other.
#[test]
fn final_gap_is_reported() {
    let mut run = Stalled::new();
    let kept = (0..27).filter(|_| run.push()).count();
    assert_eq!((kept, run.dropped.len()), (20, 7));
    run.check();
}

/// Checks a full disk, in both paces: pushing returns, the error is that of the sink, and the rows written before can
/// be read.
#[test]
fn full_disk_is_reported_at_the_end() {
    for pace in [Pace::Simulated, Pace::RealTime] {
        let sink = Sink { room: Some(100_000), ..Sink::default() };
        let (mut recorder, writer) = record(sink.clone(), Header::default(), tiny(), pace).unwrap();
        let mut k = 0;
        while recorder.is_writing() {
            recorder.wait_for_space();
            recorder.push(0, k as f64, &row(k, 9));
            k += 1;
        }
        recorder.push(0, k as f64, &row(k, 9));
        drop(recorder);
        let error = writer.finish().unwrap_err();
        let LogError::Write(error) = error else { panic!("{error}") };
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        let recording = Recording::from_bytes(&sink.bytes.lock().unwrap()).unwrap();
        assert!(recording.damage.is_some() && recording.channels[0].len() > 10);
    }
}

/// Checks a sink that accepts nothing: the error is reported before the run begins.
#[test]
fn unwritable_sink_fails_at_start() {
    let sink = Sink { room: Some(10), ..Sink::default() };
    assert!(matches!(record(sink, Header::default(), tiny(), Pace::Simulated), Err(LogError::Write(_))));
}

/// Checks a log that is finished before its recorder is dropped: it has the rows pushed before, and later rows don't
/// block.
#[test]
fn rows_after_finish_count_as_lost() {
    let (mut recorder, writer) =
        record(Cursor::new(Vec::new()), Header::default(), tiny(), Pace::Simulated).unwrap();
    recorder.push(0, 0.0, &row(0, 9));
    let (written, _) = writer.finish().unwrap();
    assert_eq!((written.records, written.dropped), (1, 0));
    assert!(!recorder.is_writing());
    (0..100).for_each(|k| recorder.push(0, k as f64, &row(k, 9)));
    assert!(recorder.dropped() > 90, "all but what the ring takes");
}

/// Checks that ten rows without further ones reach the sink although no chunk is full and the run continues.
#[test]
fn stalled_real_time_run_is_flushed() {
    let sink = Sink::default();
    let (mut recorder, _writer) =
        record(sink.clone(), Header::default(), channels(), Pace::RealTime).unwrap();
    (0..10).for_each(|k| recorder.push(0, k as f64 * 1e-3, &row(k, 9)));
    let rows = || Recording::from_bytes(&sink.bytes.lock().unwrap()).map_or(0, |r| r.channels[0].len());
    let deadline = Instant::now() + Duration::from_secs(30);
    while rows() == 0 && Instant::now() < deadline {
        thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(rows(), 10);
}

/// Checks a writer that is dropped without being finished, as after a panic: the file is complete.
#[test]
fn dropped_writer_finishes_the_file() {
    let sink = Sink::default();
    let (mut recorder, writer) = record(sink.clone(), Header::default(), tiny(), Pace::Simulated).unwrap();
    (0..10).for_each(|k| recorder.push(0, k as f64, &row(k, 9)));
    drop(writer);
    drop(recorder);
    let recording = Recording::from_bytes(&sink.bytes.lock().unwrap()).unwrap();
    assert_eq!((recording.channels[0].len(), recording.damage), (10, None));
}

/// Checks that the pushing thread allocates nothing, even when it waits or drops rows. A deliberate allocation checks
/// the counter.
#[test]
fn pushing_allocates_nothing() {
    let (mut recorder, writer) =
        record(Cursor::new(Vec::new()), Header::default(), channels(), Pace::Simulated).unwrap();
    let values = row(1, 9);
    let count = allocations(|| {
        for k in 0..20_000 {
            recorder.wait_for_space();
            recorder.push(0, k as f64 * 1e-3, &values);
            recorder.push(1, k as f64 * 1e-3, &values[..1]);
        }
    });
    assert_eq!(count, 0);
    drop(recorder);
    assert_eq!(writer.finish().unwrap().0.records, 40_000);

    let mut run = Stalled::new();
    let count = allocations(|| (0..1000).for_each(|k| run.recorder.push(0, f64::from(k), &values)));
    assert_eq!((count, run.recorder.dropped()), (0, 980));
    run.sink.open();
    let ((), one) = counted(|| drop(std::hint::black_box(vec![1_u8])));
    assert_eq!(one, Count { allocations: 1, frees: 1, largest: 1 });
}
