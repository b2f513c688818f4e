//! Logs of runs (MCAP): reading, recovery, comparison, replay and reports.

use crate::edits::{Edit, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use crate::mcap_file::{RecordEdit, Records};
use crate::root;
use bolero::{ValueGenerator, produce};
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::run::replay::replay;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::{
    ChannelData, CsvWriter, LogComparison, LogError, LogFile, MAGIC, OutcomeRecord, Pace, Recording,
    Recovery, record,
};
use opspace_report::document::{RunSection, page};
use std::io::Cursor;

/// Most memory for one log, bytes: that of a chunk of the largest size, and a copy of it.
const MOST_BYTES: usize = 160 << 20;

/// Settings of the runs whose logs are the seeds: short, and without rest before the start.
const SHORT: [&str; 3] = ["settle_s=0", "duration_s=0.04", "robot.safety.tare_s=0.01"];

/// One of so many logs is also reported: that takes longer than all else.
const RARELY: u8 = 16;

/// Bytes of a log are changed. The reader never accepts a change: rows, attachments and metadata are those of the log,
/// or fewer, and the log is damaged.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn damaged_log() {
    let seeds = seeds();
    let originals: Vec<Recording> =
        seeds.iter().map(|seed| Recording::from_bytes(seed).expect("an intact log")).collect();
    let target = Target::new("damaged_log", MOST_BYTES);
    for_each_input(edited(seeds.len()), 300, |(seed, edits)| {
        let bytes = crate::edits::apply(&seeds, *seed, edits);
        target.check(&bytes, edits.is_empty(), || {
            let Some(read) = check_log(&bytes, &seeds[*seed]) else { return false };
            let only_damage = edits.iter().all(Edit::is_damage);
            if only_damage {
                check_part(&read, &originals[*seed]);
                assert!(read.damage.is_some() || bytes == seeds[*seed], "unnoticed damage");
            }
            check_experiment(&read, bytes == seeds[*seed], false);
            true
        });
    });
}

/// Records of a log are changed, and its checksums are those of the changed records: no checksum protects the reader. A
/// log that it accepts can be recovered, compared, exported, replayed and reported.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn log_records() {
    let seeds = seeds();
    let records: Vec<Records> = seeds.iter().map(|seed| Records::of(seed)).collect();
    for (seed, records) in seeds.iter().zip(&records) {
        let again = Recording::from_bytes(&records.file()).expect("the same log");
        check_part(&again, &Recording::from_bytes(seed).expect("a log"));
    }
    let target = Target::new("log_records", MOST_BYTES);
    let edits = produce::<Vec<RecordEdit>>().with().len(0..6usize);
    let generator = (0..seeds.len(), edits, 0..RARELY).map_gen(|(seed, edits, more)| (seed, edits, more));
    for_each_input(generator, 150, |(seed, edits, more)| {
        let mut edited = records[*seed].clone();
        edits.iter().for_each(|edit| edited.edit(edit, &records));
        let bytes = edited.file();
        target.check(&bytes, edits.is_empty(), || {
            let Some(read) = check_log(&bytes, &seeds[*seed]) else { return false };
            check_experiment(&read, false, *more == 0);
            true
        });
    });
}

/// Checks a small log whose rows are wide, and whose messages have no number but the time: absent numbers are NaN in a
/// row, and need no byte in a message.
#[test]
fn wide_rows_without_numbers_need_little_memory() {
    use opspace_backend::{Layout, Signal};
    use opspace_log::{Channel, Header};
    let elements: Vec<String> = (0..20_000).map(|k| k.to_string()).collect();
    let layout = Layout { channel: "tick".to_owned(), signals: vec![Signal::new("q", "rad", &elements)] };
    let channels = vec![Channel { layout, rate_hz: 1.0 }];
    let (mut recorder, writer) =
        record(Cursor::new(Vec::new()), Header::default(), channels, Pace::Simulated).expect("a log");
    let row = vec![f64::NAN; elements.len()];
    for k in 0..1000 {
        recorder.wait_for_space();
        recorder.push(0, f64::from(k) * 1e-3, &row);
    }
    drop(recorder);
    let bytes = writer.finish().expect("a log").1.into_inner();
    assert!(bytes.len() < 2 << 20, "{} bytes", bytes.len());
    // 128 times the size of the file, and once more while the memory of the rows grows.
    Target::new("wide_rows", 300 * bytes.len()).check(&bytes, true, || Recording::from_bytes(&bytes).is_ok());
}

/// Logs of two runs of a position robot, of a part of one, and of a few rows of two channels.
fn seeds() -> Vec<Vec<u8>> {
    let run = |task: &str, settings: &[&str]| {
        let settings: Vec<String> = SHORT.iter().chain(settings).map(|set| (*set).to_owned()).collect();
        let task = root(task);
        let experiment =
            Experiment::load(Files::Disk, &task, None, RunOptions::default(), &settings).expect("a task");
        let sink = Cursor::new(Vec::new());
        experiment.run(sink, &Progress::default()).expect("a run").sink.into_inner()
    };
    let planar = run("tasks/planar-2-link-reach.toml", &[]);
    let pressing = run("tasks/press-wall.toml", &["duration_s=0.02"]);
    let mut recovered = Vec::new();
    recover(&planar[..planar.len() * 3 / 4], &mut recovered).expect("most of the log");
    vec![planar, pressing, recovered, rows()]
}

/// Log of rows that no run has written.
fn rows() -> Vec<u8> {
    use opspace_backend::{Layout, Signal};
    use opspace_log::{Attachment, Channel, Header};
    let tick = Layout {
        channel: "tick".to_owned(),
        signals: vec![
            Signal::new("q", "rad", &["shoulder", "elbow"]),
            Signal::new::<&str>("no.joints", "rad", &[]),
            Signal::new("hand.force", "N,Nm", &["x", "y", "z", "rx", "ry", "rz"]),
            Signal::scalar("fault", "1"),
            Signal::scalar("missed_cycles", "1"),
        ],
    };
    let servo = Layout { channel: "servo".to_owned(), signals: vec![Signal::scalar("i", "A")] };
    let channels = [(tick, 1000.0), (servo, 2000.0)].map(|(layout, rate_hz)| Channel { layout, rate_hz });
    let header =
        Header { attachments: vec![Attachment::new("a.txt", "text/plain", "content")], ..Header::default() };
    let (mut recorder, writer) =
        record(Cursor::new(Vec::new()), header, channels.into(), Pace::Simulated).expect("a log");
    for k in 0..30 {
        let t = f64::from(k) * 1e-3;
        recorder.wait_for_space();
        recorder.push(0, t, &[t, -0.0, f64::NAN, f64::INFINITY, 1e308, 5e-324, 0.0, 1.0, 0.0, 0.0]);
        recorder.push(1, t, &[t.sin()]);
    }
    drop(recorder);
    writer.finish().expect("a log").1.into_inner()
}

fn recover(bytes: &[u8], sink: &mut Vec<u8>) -> Result<Recovery, LogError> {
    opspace_log::recover(&LogFile::from_bytes(bytes.to_vec())?, sink)
}

fn compare_logs(first: &[u8], second: &[u8]) -> Result<LogComparison, LogError> {
    let [first, second] = [first, second].map(|bytes| LogFile::from_bytes(bytes.to_vec()));
    opspace_log::compare_logs(&first?, &second?).map_err(|(_, error)| error)
}

/// Reads a log in all ways that need no experiment; `None` if it is refused.
fn check_log(bytes: &[u8], other: &[u8]) -> Option<Recording> {
    let read = match Recording::from_bytes(bytes) {
        Ok(read) => read,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            assert_eq!(matches!(error, LogError::NotMcap), !bytes.starts_with(MAGIC), "{error}");
            assert!(LogFile::from_bytes(bytes.to_vec()).is_err() && compare_logs(bytes, other).is_err());
            assert!(recover(bytes, &mut Vec::new()).is_err());
            return None;
        }
    };
    for channel in &read.channels {
        assert_eq!(channel.rows.len(), channel.time_s.len() * channel.layout.width());
        check_csv(channel);
    }
    if let Some(damage) = &read.damage {
        assert!(!damage.what.is_empty() && damage.at_byte.is_none_or(|at| at <= bytes.len()), "{damage:?}");
    }
    assert!(read.closed || read.damage.is_some(), "a log without an end is damaged");
    let _ = OutcomeRecord::of(&read);

    let log = LogFile::from_bytes(bytes.to_vec()).expect("the log was read before").segment_values(300);
    assert_eq!((log.size_bytes(), &log.recording().damage), (bytes.len() as u64, &read.damage));
    let rows: u64 = read.channels.iter().map(|channel| channel.len() as u64).sum();
    assert_eq!(log.row_count(), rows);
    assert!(log.channels().iter().map(|channel| channel.messages).sum::<u64>() >= rows);
    let mut joined = read.clone();
    joined.channels.iter_mut().for_each(|channel| {
        channel.time_s.clear();
        channel.rows.clear();
    });
    log.for_each_segment(&mut |segment, _| {
        for (channel, part) in joined.channels.iter_mut().zip(&segment.channels) {
            channel.time_s.extend(&part.time_s);
            channel.rows.extend(&part.rows);
        }
    })
    .expect("the log was read before");
    assert_same_rows(&joined, &read);
    assert_eq!(OutcomeRecord::of(log.recording()), OutcomeRecord::of(&read));

    let same = compare_logs(bytes, bytes).unwrap_or_else(|error| panic!("{error}"));
    assert!(!same.differs(), "differs from itself: {same:?}");
    let one = compare_logs(bytes, other).unwrap_or_else(|error| panic!("{error}"));
    let two = compare_logs(other, bytes).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(one.differs(), two.differs(), "the order of the logs matters");

    check_recovery(bytes, &read);
    Some(read)
}

/// Checks that a recovered log is not damaged, and has the rows, attachments and metadata of the readable part.
fn check_recovery(bytes: &[u8], read: &Recording) {
    let mut recovered = Vec::new();
    let recovery = recover(bytes, &mut recovered).unwrap_or_else(|error| panic!("not recovered: {error}"));
    let again = Recording::from_bytes(&recovered).unwrap_or_else(|error| panic!("not recovered: {error}"));
    assert!(again.damage.is_none() && again.closed, "damaged after the recovery: {:?}", again.damage);
    assert_same_rows(&again, read);
    assert_eq!(again.attachments, read.attachments);
    assert!(again.metadata.starts_with(&read.metadata), "{:?} {:?}", again.metadata, read.metadata);
    assert_eq!(recovery.damage, read.damage);
    assert_eq!(recovery.cycles, read.channel("tick").map_or(0, |tick| tick.len() as u64));
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

fn assert_same_rows(one: &Recording, other: &Recording) {
    assert_eq!(one.channels.len(), other.channels.len());
    for (one, other) in one.channels.iter().zip(&other.channels) {
        assert_eq!(one.layout, other.layout);
        assert_eq!((bits(&one.time_s), bits(&one.rows)), (bits(&other.time_s), bits(&other.rows)));
    }
}

/// Checks that a recording has nothing that the original lacks.
fn check_part(part: &Recording, whole: &Recording) {
    for (channel, original) in part.channels.iter().zip(&whole.channels) {
        assert_eq!(channel.layout, original.layout);
        assert!(bits(&original.time_s).starts_with(&bits(&channel.time_s)));
        assert!(bits(&original.rows).starts_with(&bits(&channel.rows)));
    }
    assert!(part.attachments.iter().all(|attachment| whole.attachments.contains(attachment)));
}

/// Checks that the rows as CSV are read as the same numbers; NaN is an empty field.
fn check_csv(channel: &ChannelData) {
    let mut text = Vec::new();
    let mut writer = CsvWriter::new(&channel.layout, &mut text).expect("memory");
    writer.write_rows(channel).and_then(|()| writer.flush()).expect("memory");
    drop(writer);
    let mut reader = csv::Reader::from_reader(text.as_slice());
    let mut count = 0;
    for (k, row) in reader.records().enumerate() {
        let row = row.expect("a row");
        let numbers = std::iter::once(&channel.time_s[k]).chain(channel.row(k));
        for (field, number) in row.iter().zip(numbers) {
            let read: f64 = if field.is_empty() { f64::NAN } else { field.parse().expect("a number") };
            assert!(
                read.to_bits() == number.to_bits() || read.is_nan() && number.is_nan(),
                "{field} {number:?}"
            );
        }
        assert_eq!(row.len(), 1 + channel.layout.width());
        count += 1;
    }
    assert_eq!(count, channel.len());
}

/// Replays a log that has an experiment, and reports it if `reports`. The rows of an intact log are computed again, bit
/// for bit.
fn check_experiment(read: &Recording, is_intact: bool, reports: bool) {
    let experiment = match Experiment::of_log(read) {
        Ok(experiment) => experiment,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return;
        }
    };
    assert!(
        experiment.duration_s().is_finite() && experiment.duration_s() > 0.0,
        "{}",
        experiment.duration_s()
    );
    match replay(&experiment, read) {
        Ok(report) => {
            assert!(report.compared <= report.logged);
            assert!(report.differing <= report.compared as u64);
            assert_eq!(report.differing > 0, report.first_difference.is_some());
            if is_intact {
                assert_eq!(
                    (report.compared, report.differing),
                    (report.logged, 0),
                    "{:?}",
                    report.first_difference
                );
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    if reports {
        let summary = experiment.summary(read, &OutcomeRecord::of(read), None);
        let json = serde_json::to_string(&summary).expect("JSON");
        assert!(serde_json::from_str::<serde_json::Value>(&json).is_ok());
        let summaries = [summary.clone()];
        let html = page(
            "log",
            "a log",
            &summaries,
            &default_columns(&[]),
            &[RunSection::new(&experiment, read, summary)],
        );
        assert!(html.ends_with("</html>\n") || html.trim_end().ends_with("</html>"), "the page has no end");
        assert!(!html.contains("<fuzz>"), "text of the log is in the page without escapes");
    }
}
