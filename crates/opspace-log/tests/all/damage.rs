//! Corrupted logs: truncated anywhere, any byte changed, the process killed. Nothing panics, no wrong data are
//! accepted.
#![expect(clippy::unwrap_used, reason = "tests")]

use crate::common::{self, channels, header, is_prefix, log, row};
use opspace_log::{Header, LogError, Pace, Recording, record};
use opspace_testing::allocation::counted;
use std::fs::File;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Rows of each channel of `part` begin those of `whole`.
fn assert_prefix(part: &Recording, whole: &Recording, case: &str) {
    for (i, channel) in part.channels.iter().enumerate() {
        assert!(is_prefix(channel, &whole.channels[i]), "{case}: {}", channel.layout.channel);
    }
}

/// A part of the file against the whole: fewer rows, never other ones, and always reported.
#[test]
fn truncated_log_yields_rows_before_the_cut() {
    let (_, bytes) = log(header(), 2500);
    let whole = Recording::from_bytes(&bytes).unwrap();
    let step = bytes.len() / 400 + 1;
    let ends = bytes.len() - 600..bytes.len();
    let mut rows = 0;
    for end in (0..bytes.len()).step_by(step).chain(0..600).chain(ends) {
        match Recording::from_bytes(&bytes[..end]) {
            Ok(part) => {
                let damage = part.damage.as_ref().unwrap_or_else(|| panic!("cut at {end} unnoticed"));
                let last = part.channels.iter().filter_map(|c| c.time_s.last()).copied();
                assert_eq!(damage.after_s, last.reduce(f64::max));
                assert_prefix(&part, &whole, &format!("cut at {end}"));
                assert_eq!(part.attachments, whole.attachments, "they come first");
                assert_eq!(part.metadata, whole.metadata);
                if end % step == 0 {
                    assert!(part.channels[0].len() >= rows, "more of the file gives no fewer rows");
                    rows = part.channels[0].len();
                }
            }
            Err(LogError::NotMcap) => assert!(end < 8),
            Err(LogError::NoChannel { damage }) => assert!(damage.is_some() && end < bytes.len() / 2),
            Err(other) => panic!("{other}"),
        }
    }
    assert!(rows > 1000, "{rows} rows before the last cuts");
}

/// Every byte of a small log changed in turn: the change is always detected, and the rows still read are the
/// beginning of those recorded. No length in the file makes the reader allocate more than the largest chunk.
#[test]
fn any_changed_byte_is_detected() {
    let (_, mut bytes) = log(header(), 40);
    let whole = Recording::from_bytes(&bytes).unwrap();
    for at in 0..bytes.len() {
        for change in [0x01, 0x80, 0xff] {
            bytes[at] ^= change;
            let (read, count) = counted(|| Recording::from_bytes(&bytes));
            assert!(count.largest <= 64 << 20, "{} bytes at once, byte {at} ^ {change:02x}", count.largest);
            if let Ok(part) = read {
                assert!(part.damage.is_some(), "byte {at} ^ {change:02x} unnoticed");
                assert_prefix(&part, &whole, &format!("byte {at} ^ {change:02x}"));
            }
            bytes[at] ^= change;
        }
    }
    assert_eq!(Recording::from_bytes(&bytes).unwrap().damage, None, "all changes are undone");
}

/// A byte changed within a chunk in the middle: all rows before that chunk are read, and no others.
#[test]
fn corrupt_chunk_ends_the_valid_part() {
    let (_, mut bytes) = log(header(), 5000);
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let part = Recording::from_bytes(&bytes).unwrap();
    let damage = part.damage.unwrap();
    assert!(damage.what.contains("chunk"), "{}", damage.what);
    let seconds = part.channels[0].len() / 1000;
    assert!((1..4).contains(&seconds), "{seconds} whole seconds before the middle of five");
    assert_eq!(damage.after_s, part.channels[1].time_s.last().copied());
}

/// A chunk whose kind is changed into an unknown one, which a reader skips: the rows after it are not read as the
/// continuation of those before it.
#[test]
fn unknown_chunk_kind_leaves_no_gap() {
    let (_, mut bytes) = log(header(), 5000);
    let whole = Recording::from_bytes(&bytes).unwrap();
    // Eight bytes of magic, then records: a byte of kind, eight of length, the body.
    let (mut chunks, mut at) = (Vec::new(), 8);
    while bytes.len() - at > 8 {
        if bytes[at] == mcap::records::op::CHUNK {
            chunks.push(at);
        }
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    // The first holds the definitions, the next four a second each.
    bytes[chunks[3]] = 0x90;
    let part = Recording::from_bytes(&bytes).unwrap();
    assert_prefix(&part, &whole, "skipped");
    assert_eq!(part.channels[0].len(), 2000);
    assert!(part.damage.unwrap().what.contains("row 2000 of channel 'tick'"));
}

#[test]
fn non_log_file_is_refused() {
    assert!(matches!(Recording::from_bytes(b"time,q\n0,1\n"), Err(LogError::NotMcap)));
    assert!(matches!(Recording::from_bytes(b""), Err(LogError::NotMcap)));
    let mut foreign = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    foreign.finish().unwrap();
    let foreign = foreign.into_inner().into_inner();
    assert!(matches!(Recording::from_bytes(&foreign), Err(LogError::NoChannel { damage: None })));
    let error = Recording::read("/no/such/run.mcap").unwrap_err().to_string();
    assert!(error.contains("/no/such/run.mcap"), "{error}");
}

/// A process that records is killed (this test starts itself as that process): its log is read up to less
/// than a second of the robot's clock before its last row.
#[test]
fn killed_process_leaves_readable_log() {
    const CHILD: &str = "OPSPACE_LOG_TEST_FILE";
    let ticks = 2500;
    let time = |k: usize| k as f64 * 1e-3;
    if let Some(path) = std::env::var_os(CHILD) {
        let sink = File::create(path).unwrap();
        let (mut recorder, _writer) = record(sink, Header::default(), channels(), Pace::Simulated).unwrap();
        (0..ticks).for_each(|k| recorder.push(0, time(k), &row(k, 9)));
        sleep(Duration::from_secs(60));
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "damage::killed_process_leaves_readable_log"])
        .env(CHILD, &path)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let deadline = Instant::now() + Duration::from_secs(30);
    let rows = || Recording::read(&path).map_or(0, |r| r.channels[0].len());
    while rows() < 2000 && Instant::now() < deadline {
        sleep(Duration::from_millis(10));
    }
    // SIGKILL on Unix.
    child.kill().unwrap();
    child.wait().unwrap();

    let recording = Recording::read(&path).unwrap();
    assert!(recording.damage.is_some(), "it was not finished");
    let tick = &recording.channels[0];
    assert!((2000..=ticks).contains(&tick.len()), "{} rows", tick.len());
    for k in 0..tick.len() {
        assert_eq!(tick.time_s[k], time(k));
        assert_eq!(common::bits(tick.row(k)), common::bits(&row(k, 9)));
    }
}
