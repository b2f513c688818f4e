//! Test rows, and functions that record them to memory.
#![allow(dead_code, reason = "each test file uses a part")]

use opspace_backend::{Layout, Signal};
use opspace_log::{Attachment, Channel, ChannelData, Header, Pace, WriteStats, record};
use std::collections::BTreeMap;
use std::io::Cursor;

/// Returns the control-cycle channel of a two-joint arm, and a faster, narrower channel.
pub fn channels() -> Vec<Channel> {
    let joints = ["shoulder", "elbow"];
    let tick = Layout {
        channel: "tick".to_owned(),
        signals: vec![
            Signal::new("q", "rad", &joints),
            Signal::new("dq", "rad/s", &joints),
            Signal::new("motor_torque", "Nm", &joints),
            Signal::new::<&str>("no.joints", "rad", &[]),
            Signal::new("hand.position", "m", &["x", "y", "z"]),
        ],
    };
    let servo = Layout { channel: "servo.current".to_owned(), signals: vec![Signal::scalar("i", "A")] };
    vec![Channel { layout: tick, rate_hz: 1000.0 }, Channel { layout: servo, rate_hz: 2000.0 }]
}

/// Returns values with all kinds of bit patterns: bits that compress badly, and some special values.
pub fn row(k: usize, width: usize) -> Vec<f64> {
    let special =
        [f64::NAN, f64::from_bits(0x7ff4_0000_0000_1234), -0.0, f64::INFINITY, f64::MIN_POSITIVE / 2.0];
    let value = |i: usize| {
        let n = k * 31 + i;
        if n.is_multiple_of(17) { special[n / 17 % special.len()] } else { (n as f64 * 0.7).sin() * 1e3 }
    };
    (0..width).map(value).collect()
}

/// Time of control cycle `k`, s.
pub fn time(k: usize) -> f64 {
    (k as f64 - 2.0) * 1e-3
}

pub fn header() -> Header {
    let facts = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    Header {
        metadata: vec![("run".to_owned(), facts)],
        attachments: vec![Attachment::new("arm.urdf", "application/xml", "<robot/>")],
        ..Header::default()
    }
}

/// Returns a log of `ticks` control cycles, with two servo rows per cycle.
pub fn log(header: Header, ticks: usize) -> (WriteStats, Vec<u8>) {
    let sink = Cursor::new(Vec::new());
    let (mut recorder, writer) = record(sink, header, channels(), Pace::Simulated).expect("begins");
    for k in 0..ticks {
        recorder.wait_for_space();
        recorder.push(0, time(k), &row(k, 9));
        recorder.push(1, time(k), &row(2 * k, 1));
        recorder.push(1, time(k) + 5e-4, &row(2 * k + 1, 1));
    }
    drop(recorder);
    let (written, sink) = writer.finish().expect("ends");
    (written, sink.into_inner())
}

/// Returns the bits of the values, because NaN is not equal to itself.
pub fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}

/// Returns true if `part` is the beginning of `whole`, bit for bit.
pub fn is_prefix(part: &ChannelData, whole: &ChannelData) -> bool {
    part.layout == whole.layout
        && bits(&whole.time_s).starts_with(&bits(&part.time_s))
        && bits(&whole.rows).starts_with(&bits(&part.rows))
        && part.rows.len() == part.time_s.len() * part.layout.width()
}

/// Returns kind and byte offset of each record of a file: eight bytes of magic, then records of one byte of kind, eight
/// bytes of length, and the body.
pub fn places(bytes: &[u8]) -> Vec<(u8, usize)> {
    let (mut places, mut at) = (Vec::new(), 8);
    while bytes.len() - at > 8 {
        places.push((bytes[at], at));
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("eight bytes")) as usize;
    }
    places
}

/// Returns the byte offsets of the attachments of a file.
pub fn attachments(bytes: &[u8]) -> Vec<usize> {
    places(bytes).into_iter().filter(|(kind, _)| *kind == 9).map(|(_, at)| at).collect()
}
