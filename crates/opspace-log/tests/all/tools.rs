//! Tests of the contents, recovery, export and comparison of logs.
#![expect(clippy::unwrap_used, reason = "tests")]

use crate::common::{attachments, header, is_prefix, log, places, row};
use opspace_log::{
    Channel, CsvWriter, Header, LogComparison, LogError, LogFile, Pace, RECOVERED, Recording, Recovery,
    record,
};
use std::io::Cursor;

fn recover(bytes: &[u8], sink: &mut Vec<u8>) -> Result<Recovery, LogError> {
    opspace_log::recover(&LogFile::from_bytes(bytes.to_vec())?, sink)
}

fn compare_logs(first: &[u8], second: &[u8]) -> Result<LogComparison, LogError> {
    let [first, second] = [first, second].map(|bytes| LogFile::from_bytes(bytes.to_vec()));
    opspace_log::compare_logs(&first?, &second?).map_err(|(_, error)| error)
}

/// Compared: numbers of messages and the rows of the run; sizes of the file and of its messages.
#[test]
fn contents_count_messages_of_each_channel() {
    let (_, bytes) = log(header(), 2500);
    let contents = LogFile::from_bytes(bytes.clone()).unwrap();
    let of = |topic: &str| contents.channels().iter().find(|c| c.topic == topic).unwrap();
    assert_eq!((of("/opspace/tick").messages, of("/opspace/servo.current").messages), (2500, 5000));
    assert_eq!((of("/joint_states").messages, of("/log").messages), (125, 0));
    assert_eq!(of("/opspace/servo.current").schema, "opspace.ServoCurrent");
    assert!(of("/opspace/tick").bytes > 2500 * 9 * 8, "{contents:?}");
    assert_eq!(contents.size_bytes(), bytes.len() as u64);
    assert!(contents.recording().closed);
}

/// Cuts and corrupts a log: the recovered log is whole, and has exactly the rows, attachments and metadata that can be
/// read of the damaged one, and what is lost is known where the log still has its end.
#[test]
fn recovered_log_is_whole_and_has_all_readable_rows() {
    let (_, bytes) = log(header(), 5000);
    let middle = bytes.len() / 2;
    let mut corrupt = bytes.clone();
    corrupt[middle] ^= 1;
    let mut attachment = bytes.clone();
    attachment[attachments(&bytes)[0] + 60] ^= 1;
    let end = bytes.len() - 20;
    for (case, damaged) in [
        ("cut", &bytes[..middle]),
        ("corrupt", &corrupt),
        ("attachment", &attachment),
        ("end", &bytes[..end]),
    ] {
        let part = Recording::from_bytes(damaged).unwrap();
        let mut recovered = Vec::new();
        let recovery = recover(damaged, &mut recovered).unwrap();
        let read = Recording::from_bytes(&recovered).unwrap();
        assert_eq!((&read.damage, read.closed), (&None, true), "{case}");
        for (channel, original) in read.channels.iter().zip(&part.channels) {
            assert!(channel.len() == original.len() && is_prefix(channel, original), "{case}");
        }
        assert_eq!(read.attachments, part.attachments, "{case}");
        assert_eq!(read.metadata[..part.metadata.len()], part.metadata[..], "{case}");
        assert_eq!(read.metadata(RECOVERED).unwrap()["cycles"], recovery.cycles.to_string());
        assert_eq!(recovery.cycles, part.channels[0].len() as u64, "{case}");
        assert_eq!(recovery.damage, part.damage, "{case}");
        let lost = match case {
            "corrupt" => Some(5000 - recovery.cycles),
            "attachment" => Some(0),
            _ => None,
        };
        assert_eq!(recovery.lost_cycles, lost, "{case}");
        assert!(recovery.data_lost());
        // Readers of other programs need the index at the end.
        let summary = mcap::Summary::read(&recovered).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().channel_message_counts[&1], recovery.cycles, "{case}");
        assert!(
            !summary.chunk_indexes.is_empty() && !summary.attachment_indexes.is_empty()
                || case == "attachment"
        );
    }
    let mut copy = Vec::new();
    let recovery = recover(&bytes, &mut copy).unwrap();
    assert!(!recovery.data_lost() && recovery.damage.is_none());
    assert!(!compare_logs(&bytes, &copy).unwrap().differs());
    assert_eq!(Recording::from_bytes(&copy).unwrap().metadata(RECOVERED), None);
}

/// Returns a log of two channels, one of them of wall-clock times, after a change of its rows.
fn timed(change: impl Fn(usize, &mut [f64]), elapsed: f64) -> Vec<u8> {
    let mut layouts = crate::common::channels();
    layouts[1].layout.channel = "timing".to_owned();
    let sink = Cursor::new(Vec::new());
    let channels: Vec<Channel> = layouts;
    let (mut recorder, writer) = record(sink, Header::default(), channels, Pace::Simulated).unwrap();
    for k in 0..300 {
        let mut values = row(k, 9);
        change(k, &mut values);
        recorder.push(0, k as f64 * 1e-3, &values);
        recorder.push(1, k as f64 * 1e-3, &[elapsed + k as f64]);
    }
    drop(recorder);
    writer.finish().unwrap().1.into_inner()
}

/// Checks that wall-clock times do not count, and that the first difference of each other channel is found, with its
/// field, time and values.
#[test]
fn comparison_finds_the_first_difference_of_each_channel() {
    let one = timed(|_, _| (), 0.0);
    let same = compare_logs(&one, &timed(|_, _| (), 7.0)).unwrap();
    assert!(!same.differs());
    let differing: Vec<&str> =
        same.channels.iter().filter(|c| c.differs()).map(|c| c.topic.as_str()).collect();
    assert_eq!(differing, ["/opspace/timing"]);

    let changed = timed(|k, values| values[5] = if k >= 203 { values[5] + 1.0 } else { values[5] }, 0.0);
    let other = compare_logs(&one, &changed).unwrap();
    assert!(other.differs());
    let of = |topic: &str| other.channels.iter().find(|c| c.topic == topic).unwrap().first.clone().unwrap();
    let tick = of("/opspace/tick");
    assert_eq!((tick.message, tick.time_ns, tick.field.as_str()), (203, 203_000_000, "motor_torque.elbow"));
    let was = row(203, 9)[5];
    assert_eq!(tick.values, [Some(format!("{was:?}")), Some(format!("{:?}", was + 1.0))]);
    // The next message for viewers after that row.
    let joints = of("/joint_states");
    assert_eq!((joints.message, joints.field.as_str()), (11, "joints[1].effort"));

    let absent = timed(|k, values| values[0] = if k == 5 { f64::NAN } else { values[0] }, 0.0);
    let first = compare_logs(&one, &absent).unwrap().channels[0].first.clone().unwrap();
    assert_eq!((first.message, first.field.as_str()), (5, "q.shoulder"));
    assert_eq!(first.values[1], None);
}

/// Checks that attachments and metadata count: another content, another entry, and a part that only one log has.
#[test]
fn comparison_finds_other_attachments_and_metadata() {
    let with = |change: &dyn Fn(&mut Header)| {
        let mut header = header();
        change(&mut header);
        log(header, 50).1
    };
    let one = with(&|_| ());
    assert!(!compare_logs(&one, &with(&|_| ())).unwrap().differs());
    let text = |header: &mut Header, text: &str| header.attachments[0].data = text.as_bytes().to_vec();
    let seed = |header: &mut Header| {
        header.metadata[0].1.insert("seed".to_owned(), "8".to_owned());
    };
    let cases = [
        (
            with(&|header| text(header, "<robot/>\n<!-- -->")),
            "attachment 'arm.urdf'",
            Some("line 2"),
            [None, Some("<!-- -->")],
        ),
        (
            with(&|header| header.attachments[0].data = vec![0xff, 0]),
            "attachment 'arm.urdf'",
            Some("byte 0"),
            [Some("0x3c"), Some("0xff")],
        ),
        (with(&seed), "metadata 'run'", Some("seed"), [Some("7"), Some("8")]),
        (with(&|header| header.attachments.clear()), "attachment 'arm.urdf'", None, [Some("present"), None]),
    ];
    for (other, part, place, values) in cases {
        let comparison = compare_logs(&one, &other).unwrap();
        let [found] = comparison.parts.as_slice() else { panic!("{:?}", comparison.parts) };
        assert!(comparison.differs() && !comparison.is_damaged());
        assert_eq!((found.part.as_str(), found.place.as_deref()), (part, place));
        assert_eq!(found.values.each_ref().map(Option::as_deref), values);
    }
}

/// Checks that a damaged attachment is no difference, but that the log is not whole either.
#[test]
fn lost_attachment_is_damage_and_no_difference() {
    let (_, bytes) = log(header(), 50);
    let mut damaged = bytes.clone();
    let place = bytes.windows(8).position(|window| window == b"<robot/>").unwrap();
    damaged[place] ^= 1;
    let comparison = compare_logs(&bytes, &damaged).unwrap();
    assert!(!comparison.differs() && comparison.is_damaged(), "{comparison:?}");
}

/// Checks that a truncated log is compared up to its end, and that a longer log differs.
#[test]
fn comparison_ends_at_damage_but_not_at_a_shorter_log() {
    let (_, bytes) = log(header(), 3000);
    let cut = compare_logs(&bytes, &bytes[..bytes.len() / 2]).unwrap();
    assert!(!cut.differs() && cut.is_damaged() && cut.damage[1].is_some());
    let (_, shorter) = log(header(), 2999);
    let other = compare_logs(&bytes, &shorter).unwrap();
    assert!(other.differs() && other.channels.iter().any(|c| c.lengths_differ));
}

/// Compared: numbers in the text and in the rows, bit for bit; names of columns and units.
#[test]
fn exported_rows_are_those_of_the_log() {
    let (_, bytes) = log(header(), 50);
    let recording = Recording::from_bytes(&bytes).unwrap();
    let tick = &recording.channels[0];
    let mut text = Vec::new();
    let mut csv = CsvWriter::new(&tick.layout, &mut text).unwrap();
    csv.write_rows(tick).and_then(|()| csv.flush()).unwrap();
    drop(csv);
    let text = String::from_utf8(text).unwrap();
    let mut lines = text.lines();
    let head = "time_s,q.shoulder_rad,q.elbow_rad,dq.shoulder_rad_per_s,dq.elbow_rad_per_s,\
                motor_torque.shoulder_nm,motor_torque.elbow_nm,hand.position.x_m,hand.position.y_m,hand.position.z_m";
    assert_eq!(lines.next().unwrap(), head);
    for (k, line) in lines.enumerate() {
        let mut fields = line.split(',');
        assert_eq!(fields.next().unwrap().parse::<f64>().unwrap().to_bits(), tick.time_s[k].to_bits());
        for (field, value) in fields.zip(tick.row(k)) {
            match field {
                "" => assert!(value.is_nan()),
                number => assert_eq!(number.parse::<f64>().unwrap().to_bits(), value.to_bits()),
            }
        }
    }
    assert_eq!(text.lines().count(), 51);
}

/// Flips bits everywhere in a small log: no tool panics, and a recovered log is whole.
#[test]
fn tools_bear_any_damage() {
    let (_, mut bytes) = log(header(), 20);
    let whole = bytes.clone();
    let last = places(&bytes).len();
    assert!(last > 5);
    for at in (0..bytes.len()).step_by(11) {
        bytes[at] ^= 0x21;
        let _ = LogFile::from_bytes(bytes.clone());
        let _ = compare_logs(&whole, &bytes);
        let mut out = Vec::new();
        if recover(&bytes, &mut out).is_ok() {
            assert_eq!(Recording::from_bytes(&out).unwrap().damage, None, "byte {at}");
        }
        bytes[at] ^= 0x21;
    }
}

/// Compared: the rows of all segments, of several sizes, and those of the log; the times of rows of one cycle, and those
/// of the segments before and after.
#[test]
fn segments_have_all_rows_and_divide_no_cycle() {
    let (_, bytes) = log(header(), 2500);
    let whole = Recording::from_bytes(&bytes).unwrap();
    for values in [1, 1000, 7777, 1 << 20] {
        let file = LogFile::from_bytes(bytes.clone()).unwrap().segment_values(values);
        let mut read: Vec<(Vec<f64>, Vec<f64>)> = vec![Default::default(); whole.channels.len()];
        let (mut segments, mut last_s, mut ended) = (0, f64::NEG_INFINITY, false);
        file.for_each_segment(&mut |segment, is_last| {
            assert!(!ended);
            ended = is_last;
            segments += 1;
            let times = || segment.channels.iter().flat_map(|channel| channel.time_s.iter().copied());
            assert!(times().all(|time_s| time_s > last_s), "{values}");
            last_s = times().fold(last_s, f64::max);
            for (channel, (time_s, rows)) in segment.channels.iter().zip(&mut read) {
                time_s.extend(&channel.time_s);
                rows.extend(&channel.rows);
            }
        })
        .unwrap();
        assert!(ended && if values < 10_000 { segments > 3 } else { segments == 1 }, "{values}: {segments}");
        for (channel, (time_s, rows)) in whole.channels.iter().zip(read) {
            assert_eq!(channel.time_s, time_s);
            assert!(channel.rows.iter().map(|v| v.to_bits()).eq(rows.iter().map(|v| v.to_bits())));
        }
        assert_eq!(file.row_count(), whole.channels.iter().map(|c| c.len() as u64).sum::<u64>());
    }
}

/// Checks the error about a log that becomes shorter while it is read.
#[test]
fn changed_file_is_refused() {
    let (_, bytes) = log(header(), 2500);
    let path = std::env::temp_dir().join(format!("opspace-changed-{}.mcap", std::process::id()));
    std::fs::write(&path, &bytes).unwrap();
    let file = LogFile::open(&path).unwrap();
    std::fs::File::options().write(true).open(&path).unwrap().set_len(bytes.len() as u64 / 2).unwrap();
    let error = file.for_each_segment(&mut |_, _| ()).unwrap_err().to_string();
    std::fs::remove_file(&path).unwrap();
    assert!(error.contains("changed while it was read"), "{error}");
}
