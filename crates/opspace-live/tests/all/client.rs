//! Client of a view, as a page is one.

use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// Longest time that a test waits for a message: much longer than it takes.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// Numbers of the client's channels.
const HAND: u32 = 1;
const CONTROL: u32 = 2;

/// Client with an open WebSocket.
pub struct Client {
    stream: TcpStream,
    bytes: Vec<u8>,
    /// Channels of the server, by topic.
    pub channels: BTreeMap<String, Value>,
    /// Subscriptions, and the last message of each topic.
    subscriptions: BTreeMap<u32, String>,
    pub last: BTreeMap<String, Vec<u8>>,
    pub warnings: Vec<String>,
}

/// Answer to a request, as text, up to the end of its head or of the connection.
pub fn ask(address: SocketAddr, request: &str) -> (TcpStream, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let (mut answer, mut byte) = (Vec::new(), [0]);
    while !answer.ends_with(b"\r\n\r\n") && stream.read(&mut byte).unwrap_or(0) > 0 {
        answer.push(byte[0]);
    }
    (stream, String::from_utf8(answer).unwrap())
}

/// Request for a WebSocket with further headers.
pub fn upgrade(address: SocketAddr, target: &str, headers: &str) -> String {
    format!(
        "GET {target} HTTP/1.1\r\nHost: {address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n{headers}\r\n"
    )
}

/// Frame of a client.
pub fn frame(first: u8, content: &[u8]) -> Vec<u8> {
    let mask = [1, 2, 3, 4];
    let mut out = vec![first];
    match content.len() {
        length @ 0..126 => out.push(0x80 | length as u8),
        length => {
            out.push(0x80 | 126);
            out.extend(u16::try_from(length).unwrap().to_be_bytes());
        }
    }
    out.extend(mask);
    out.extend(content.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
    out
}

impl Client {
    /// Connects, subscribes to all topics as they are announced, and announces its own channels.
    pub fn connect(address: SocketAddr) -> Self {
        let (stream, answer) = ask(address, &upgrade(address, "/", ""));
        assert!(answer.starts_with("HTTP/1.1 101"), "{answer}");
        stream.set_read_timeout(Some(Duration::from_millis(2))).unwrap();
        let mut client = Self {
            stream,
            bytes: Vec::new(),
            channels: BTreeMap::new(),
            subscriptions: BTreeMap::new(),
            last: BTreeMap::new(),
            warnings: Vec::new(),
        };
        let channel = |id, topic| json!({ "id": id, "topic": topic, "encoding": "json", "schemaName": "" });
        let channels = [channel(HAND, "/hand"), channel(CONTROL, "/control")];
        client.send(0x81, json!({ "op": "advertise", "channels": channels }).to_string().as_bytes());
        client
    }

    /// Sends bytes as they are; a server that has closed the connection does not take them.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        let _ = self.stream.write_all(bytes);
    }

    pub fn send(&mut self, first: u8, content: &[u8]) {
        self.send_raw(&frame(first, content));
    }

    fn data(&mut self, channel: u32, content: &Value) {
        let content = [&[1][..], &channel.to_le_bytes(), content.to_string().as_bytes()].concat();
        self.send(0x82, &content);
    }

    pub fn hand(&mut self, content: &Value) {
        self.data(HAND, content);
    }

    pub fn control(&mut self, content: &Value) {
        self.data(CONTROL, content);
    }

    /// Reads what has arrived; returns false once the server has closed the connection.
    pub fn read(&mut self) -> bool {
        let mut part = [0; 64 << 10];
        match self.stream.read(&mut part) {
            Ok(0) => return false,
            Ok(count) => self.bytes.extend_from_slice(&part[..count]),
            Err(error)
                if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {}
            Err(_) => return false,
        }
        let bytes = std::mem::take(&mut self.bytes);
        let mut rest = &bytes[..];
        while let Some((first, content, after)) = first_frame(rest) {
            self.receive(first, content);
            rest = after;
        }
        self.bytes = rest.to_vec();
        true
    }

    /// Reads until `is_done`.
    pub fn read_until(&mut self, is_done: impl Fn(&Self) -> bool) {
        let begin = Instant::now();
        while !is_done(self) {
            assert!(
                self.read() && begin.elapsed() < PATIENCE,
                "what was awaited did not arrive: {:?}",
                self.warnings
            );
        }
    }

    /// State of the view.
    pub fn view(&self) -> Value {
        self.last.get("/view").map_or(Value::Null, |view| serde_json::from_slice(view).unwrap())
    }

    fn receive(&mut self, first: u8, content: &[u8]) {
        if first == 0x82 && content[0] == 1 {
            let subscription = u32::from_le_bytes(content[1..5].try_into().unwrap());
            let topic = self.subscriptions[&subscription].clone();
            self.last.insert(topic, content[13..].to_vec());
        }
        if first != 0x81 {
            return;
        }
        let text: Value = serde_json::from_slice(content).unwrap();
        match text["op"].as_str().unwrap() {
            "advertise" => {
                let mut subscriptions = Vec::new();
                for channel in text["channels"].as_array().unwrap() {
                    let topic = channel["topic"].as_str().unwrap().to_owned();
                    let id = 100 + channel["id"].as_u64().unwrap() as u32;
                    self.subscriptions.insert(id, topic.clone());
                    self.channels.insert(topic, channel.clone());
                    subscriptions.push(json!({ "id": id, "channelId": channel["id"] }));
                }
                let subscribe = json!({ "op": "subscribe", "subscriptions": subscriptions });
                self.send(0x81, subscribe.to_string().as_bytes());
            }
            "status" => self.warnings.push(text["message"].as_str().unwrap().to_owned()),
            _ => {}
        }
    }
}

/// First frame of a server: its first byte, its content, and the bytes after it.
fn first_frame(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&first, rest) = bytes.split_first()?;
    let (&short, rest) = rest.split_first()?;
    let width = match short {
        126 => 2,
        127 => 8,
        _ => 0,
    };
    let (long, rest) = rest.split_at_checked(width)?;
    let length =
        if width == 0 { u64::from(short) } else { long.iter().fold(0, |n, b| n << 8 | u64::from(*b)) };
    let (content, rest) = rest.split_at_checked(length as usize)?;
    Some((first, content, rest))
}
