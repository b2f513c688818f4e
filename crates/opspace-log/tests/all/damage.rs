//! Tests of corrupted logs: truncation at any byte, a change of any byte, a killed process. Nothing panics, and no
//! wrong data are accepted.
#![expect(clippy::unwrap_used, reason = "tests")]

use crate::common::{self, attachments, channels, header, is_prefix, log, places, row};
use opspace_backend::{Layout, Signal};
use opspace_log::{Attachment, Channel, Header, LogError, Pace, Recording, record};
use opspace_testing::allocation::counted;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Cursor;
use std::process::Command;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Checks that the rows of each channel of `part` are the first rows of `whole`.
fn assert_prefix(part: &Recording, whole: &Recording, case: &str) {
    for (i, channel) in part.channels.iter().enumerate() {
        assert!(is_prefix(channel, &whole.channels[i]), "{case}: {}", channel.layout.channel);
    }
}

/// Compared: a truncated file and the whole: fewer rows, never different ones, and the damage is always reported.
#[test]
fn truncated_log_yields_rows_before_the_cut() {
    let (_, bytes) = log(header(), 2500);
    let whole = Recording::from_bytes(&bytes).unwrap();
    let step = bytes.len() / 150 + 1;
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

/// Changes every byte of a small log, one at a time: the change is always detected, and the rows read are the first of
/// the recorded rows. The reader never allocates more than the largest chunk.
#[test]
fn any_changed_byte_is_detected() {
    let (_, mut bytes) = log(header(), 40);
    let whole = Recording::from_bytes(&bytes).unwrap();
    for at in 0..bytes.len() {
        let change = [0x01, 0x80, 0xff][at % 3];
        bytes[at] ^= change;
        let (read, count) = counted(|| Recording::from_bytes(&bytes));
        assert!(count.largest <= 64 << 20, "{} bytes at once, byte {at} ^ {change:02x}", count.largest);
        if let Ok(part) = read {
            assert!(part.damage.is_some(), "byte {at} ^ {change:02x} unnoticed");
            assert_prefix(&part, &whole, &format!("byte {at} ^ {change:02x}"));
        }
        bytes[at] ^= change;
    }
    assert_eq!(Recording::from_bytes(&bytes).unwrap().damage, None, "all changes are undone");
}

/// Changes a byte in a chunk in the middle: exactly the rows before that chunk are read.
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

/// Flips each bit of an attachment: all rows are read, and the message names the attachment, unless the bit is in the
/// length of the record, which is then found from the lengths of its fields, or in its kind. The other attachment is
/// always read.
#[test]
fn flipped_bit_of_an_attachment_costs_that_attachment() {
    let mut header = header();
    header.attachments.push(Attachment::new("task.toml", "application/toml", "seed = 1"));
    let (_, mut bytes) = log(header, 30);
    let whole = Recording::from_bytes(&bytes).unwrap();
    let begin = attachments(&bytes)[0];
    let body = u64::from_le_bytes(bytes[begin + 1..begin + 9].try_into().unwrap()) as usize;
    for at in begin..begin + 9 + body {
        for bit in 0..8 {
            bytes[at] ^= 1 << bit;
            let read = Recording::from_bytes(&bytes).unwrap();
            let damage = read.damage.as_ref().unwrap_or_else(|| panic!("bit {bit} of byte {at} unnoticed"));
            assert!(!damage.rows_lost, "bit {bit} of byte {}: {damage}", at - begin);
            assert!(damage.to_string().contains("all rows are readable"), "{damage}");
            for (channel, original) in read.channels.iter().zip(&whole.channels) {
                assert_eq!(channel.len(), original.len());
            }
            assert_eq!(read.attachment("task.toml"), whole.attachment("task.toml"));
            if at >= begin + 9 {
                assert_eq!(read.damaged_parts.len(), 1, "bit {bit} of byte {}: {damage}", at - begin);
                assert!(damage.what.contains("attachment"), "{damage}");
                assert_eq!(damage.at_byte, Some(begin));
            }
            bytes[at] ^= 1 << bit;
        }
    }
    bytes[begin + 9 + body - 8] ^= 1;
    let damage = Recording::from_bytes(&bytes).unwrap().damage.unwrap().to_string();
    assert!(damage.contains("the attachment 'arm.urdf'"), "{damage}");
}

/// Flips bits in the summary: all rows and attachments are read, and the message says so if the statistics or the
/// rest of the summary confirm it.
#[test]
fn flipped_bit_of_the_summary_costs_no_row() {
    let (_, mut bytes) = log(header(), 30);
    let whole = Recording::from_bytes(&bytes).unwrap();
    let end = places(&bytes).into_iter().find(|&(kind, _)| kind == mcap::records::op::DATA_END).unwrap().1;
    for at in (end + 13..bytes.len()).step_by(3) {
        bytes[at] ^= 0x10;
        let read = Recording::from_bytes(&bytes).unwrap();
        assert!(read.damage.is_some(), "byte {at} unnoticed");
        for (channel, original) in read.channels.iter().zip(&whole.channels) {
            assert_eq!(channel.len(), original.len());
        }
        assert_eq!((&read.attachments, &read.metadata), (&whole.attachments, &whole.metadata));
        bytes[at] ^= 0x10;
    }
}

/// Changes the kind of a chunk to an unknown one, which a reader skips: the rows after it must not be read as if they
/// followed the rows before it.
#[test]
fn unknown_chunk_kind_leaves_no_gap() {
    let (_, mut bytes) = log(header(), 5000);
    let whole = Recording::from_bytes(&bytes).unwrap();
    let places = places(&bytes);
    let chunks: Vec<usize> = places.iter().filter(|p| p.0 == mcap::records::op::CHUNK).map(|p| p.1).collect();
    // The first chunk has the definitions, each of the next four one second of rows.
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

/// Kills a process that records (this test starts itself as that process): its log is readable up to less than a second
/// before its last row, on the robot's clock.
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

/// Checks that attachments are read up to a size in all: each of these is small enough alone.
#[test]
fn attachments_are_limited_together() {
    let attachment = |name: &str| Attachment::new(name, "application/octet-stream", vec![7; 24 << 20]);
    let attachments = ["a", "b", "c"].map(attachment).to_vec();
    let (_, bytes) = log(Header { attachments, ..header() }, 10);
    let refused = match Recording::from_bytes(&bytes) {
        Ok(recording) => recording.damage.map(|damage| damage.what),
        Err(error) => Some(error.to_string()),
    };
    assert!(refused.as_ref().is_some_and(|what| what.contains("bytes of memory")), "{refused:?}");
}

/// Checks a file whose chunks expand to far more than any log of its size: it is refused before they are all unpacked.
#[test]
fn chunks_that_expand_too_much_are_refused() {
    const MEGABYTE: usize = 1 << 20;
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).expect("a writer");
    let channel = writer.add_channel(0, "zeros", "none", &BTreeMap::new()).expect("a channel");
    let zeros = vec![0; MEGABYTE];
    for sequence in 0..64 {
        let header =
            mcap::records::MessageHeader { channel_id: channel, sequence, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &zeros).expect("a message");
    }
    writer.finish().expect("an end");
    let bytes = writer.into_inner().into_inner();
    assert!(bytes.len() < MEGABYTE / 4, "{} bytes", bytes.len());
    // Nothing behind the data raises the limit: a hole in a file has a size and takes no place.
    for padding in [0, 4 * MEGABYTE] {
        let padded = [bytes.as_slice(), &vec![0; padding]].concat();
        let error = Recording::from_bytes(&padded).expect_err("no log").to_string();
        assert!(error.contains("expand to more than"), "{padding}: {error}");
    }
}

/// Checks that a log in which nothing changes, and in which most numbers are absent, is read: its rows need many times the
/// memory that the file has bytes.
#[test]
fn log_of_a_robot_at_rest_is_read() {
    const ROWS: usize = 20_000;
    for present in [300, 50] {
        let elements: Vec<String> = (0..300).map(|k| k.to_string()).collect();
        let layout = Layout { channel: "tick".to_owned(), signals: vec![Signal::new("q", "rad", &elements)] };
        let channels = vec![Channel { layout, rate_hz: 1000.0 }];
        let (mut recorder, writer) =
            record(Cursor::new(Vec::new()), Header::default(), channels, Pace::Simulated).unwrap();
        let row: Vec<f64> = (0..300).map(|k| if k < present { f64::from(k) } else { f64::NAN }).collect();
        for k in 0..ROWS {
            recorder.wait_for_space();
            recorder.push(0, k as f64 * 1e-3, &row);
        }
        drop(recorder);
        let recording = Recording::from_bytes(writer.finish().unwrap().1.get_ref()).unwrap();
        assert_eq!((&recording.damage, recording.channels[0].len()), (&None, ROWS), "{present} numbers");
    }
}
