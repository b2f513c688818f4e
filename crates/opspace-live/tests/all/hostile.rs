//! Clients that send what no page sends: the view answers others as before.

use crate::client::{Client, ask, frame};
use opspace_live::{LiveView, ViewKind};
use serde_json::json;
use std::io::Write;
use std::net::TcpStream;
use std::time::Duration;

/// Malformed frames close their connection; messages that are not understood are named; other connections remain.
#[test]
fn hostile_messages_harm_nobody() {
    let view = LiveView::start("127.0.0.1:0".parse().unwrap(), "test", ViewKind::Run).unwrap();
    let address = view.address().socket;
    let mut page = Client::connect(address);
    page.read_until(|page| page.last.contains_key("/view"));
    let long = [&[0x82, 0xff][..], &[0xff; 8]].concat();
    let malformed: [&[u8]; 6] = [
        &[0x81, 1, b'a'],
        &frame(0xc1, b"a"),
        &frame(0x83, b"a"),
        &frame(0x80, b"a"),
        &long,
        &frame(0x81, &[0xff]),
    ];
    for bytes in malformed {
        let mut client = Client::connect(address);
        client.send_raw(bytes);
        while client.read() {}
    }
    // Connections that say nothing, and ones that are cut off.
    let silent: Vec<TcpStream> = (0..8).map(|_| TcpStream::connect(address).unwrap()).collect();
    for _ in 0..50 {
        let mut cut = TcpStream::connect(address).unwrap();
        let _ = cut.write_all(b"GET / HTTP/1.1\r\nHost");
    }
    drop(ask(address, "\r\n\r\n"));
    for text in
        ["", "{}", "[1, 2", r#"{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 4000000000}]}"#]
    {
        page.send(0x81, text.as_bytes());
    }
    page.send(0x82, &[]);
    page.send(0x82, &[1, 9, 9, 9, 9]);
    page.hand(&json!({ "frame": "no link", "point_m": [0, 0, 0], "target_m": [0, 0, 0] }));
    page.hand(&json!({ "frame": "hand", "point_m": [1e300, 0, 0], "target_m": [0, 0, 0] }));
    page.control(&json!({ "op": "speed", "value": -1 }));
    page.control(&json!({ "op": "play" }));
    page.read_until(|page| page.warnings.len() >= 10);
    page.send(0x89, b"still there?");
    let dropped = view.dropped();
    page.read_until(|page| page.view()["dropped_pictures"] == dropped);
    drop(silent);
}

/// A page that reads nothing delays no one: what it misses is counted, and its queue is bounded.
#[test]
fn slow_page_loses_messages() {
    let view = LiveView::start("127.0.0.1:0".parse().unwrap(), "test", ViewKind::Run).unwrap();
    let address = view.address().socket;
    let mut slow = Client::connect(address);
    // Asks for an answer to each of many messages, and reads none.
    for _ in 0..20_000 {
        slow.send(0x81, b"x");
    }
    let mut page = Client::connect(address);
    page.read_until(|page| page.last.contains_key("/view"));
    page.send(0x88, &[]);
    while page.read() {}
    drop(slow);
    let begin = std::time::Instant::now();
    while view.pages() > 0 {
        assert!(begin.elapsed() < crate::client::PATIENCE);
        std::thread::sleep(Duration::from_millis(5));
    }
}
