//! Foxglove's protocol of live messages, as far as a view needs it
//! (<https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>): what a client asks for, and what the server says. Text and bytes
//! in and out: no socket is touched here.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde::Deserialize;
use serde_json::{Value, json};

/// Opcode of messages, of the server and of clients.
pub const MESSAGE_DATA: u8 = 1;

/// Level of a status that warns.
const WARNING: u8 = 1;

/// Longest part of a text of a client that an answer repeats, characters.
const LONGEST_QUOTE: usize = 80;

/// Channel of the server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerChannel {
    /// Topic.
    pub topic: String,
    /// Encoding of the messages: `protobuf`, `cdr` or `json`.
    pub encoding: String,
    /// Name of the messages' type.
    pub schema_name: String,
    /// Encoding of its definition: `protobuf`, `ros2msg` or `jsonschema`.
    pub schema_encoding: String,
    /// Definition.
    pub schema: Vec<u8>,
}

/// Request of a client.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
pub enum ClientText {
    /// Sends the messages of channels from now on.
    Subscribe {
        /// Subscriptions.
        subscriptions: Vec<Subscription>,
    },
    /// Ends subscriptions.
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        /// Numbers of the subscriptions.
        subscription_ids: Vec<u32>,
    },
    /// Announces channels of the client.
    Advertise {
        /// Channels.
        channels: Vec<ClientChannel>,
    },
    /// Removes channels of the client.
    #[serde(rename_all = "camelCase")]
    Unadvertise {
        /// Numbers of the channels.
        channel_ids: Vec<u32>,
    },
}

/// Subscription of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscription {
    /// Number that the client chose.
    pub id: u32,
    /// Number of the server's channel.
    pub channel_id: u32,
}

/// Channel of a client.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct ClientChannel {
    /// Number that the client chose.
    pub id: u32,
    /// Topic.
    pub topic: String,
    /// Encoding of the messages.
    pub encoding: String,
}

/// Reads a text of a client.
///
/// # Errors
/// A text that is no request of this protocol, with a description.
pub fn parse_text(text: &str) -> Result<ClientText, String> {
    serde_json::from_str(text).map_err(|error| format!("not understood: {} ({error})", quote(text)))
}

/// Reads a message of a client's channel: number of the channel, and content.
///
/// # Errors
/// Bytes that are no such message, with a description.
pub fn parse_binary(bytes: &[u8]) -> Result<(u32, &[u8]), String> {
    match bytes {
        [MESSAGE_DATA, a, b, c, d, content @ ..] => Ok((u32::from_le_bytes([*a, *b, *c, *d]), content)),
        [opcode, ..] => Err(format!("no message of a client: opcode {opcode}, {} bytes", bytes.len())),
        [] => Err("a message without content".to_owned()),
    }
}

/// Beginning of a text of a client, for an answer.
#[must_use]
pub fn quote(text: &str) -> String {
    let mut quoted: String = text.chars().take(LONGEST_QUOTE).collect();
    if quoted.len() < text.len() {
        quoted.push('…');
    }
    format!("{quoted:?}")
}

/// First text of the server.
#[must_use]
pub fn server_info(name: &str, session: &str) -> String {
    json!({
        "op": "serverInfo",
        "name": name,
        "capabilities": ["clientPublish", "time"],
        "supportedEncodings": ["json"],
        "sessionId": session,
    })
    .to_string()
}

/// Announces channels of the server, with their numbers.
#[must_use]
pub fn advertise<'a>(channels: impl IntoIterator<Item = (u32, &'a ServerChannel)>) -> String {
    let channel = |(id, channel): (u32, &ServerChannel)| {
        let ServerChannel { topic, encoding, schema_name, schema_encoding, schema } = channel;
        // Definitions that are not text are encoded as one.
        let schema = match (schema_encoding.as_str(), std::str::from_utf8(schema)) {
            ("protobuf", _) | (_, Err(_)) => BASE64_STANDARD.encode(schema),
            (_, Ok(text)) => text.to_owned(),
        };
        json!({
            "id": id,
            "topic": topic,
            "encoding": encoding,
            "schemaName": schema_name,
            "schema": schema,
            "schemaEncoding": schema_encoding,
        })
    };
    let channels: Vec<Value> = channels.into_iter().map(channel).collect();
    json!({ "op": "advertise", "channels": channels }).to_string()
}

/// Removes channels of the server.
#[must_use]
pub fn unadvertise(ids: &[u32]) -> String {
    json!({ "op": "unadvertise", "channelIds": ids }).to_string()
}

/// Warns a client.
#[must_use]
pub fn warning(message: &str) -> String {
    json!({ "op": "status", "level": WARNING, "message": message }).to_string()
}

/// Bytes before the content of a message, for a subscription, at a time of the log (ns).
#[must_use]
pub fn message_header(subscription: u32, log_time_ns: u64) -> [u8; 13] {
    let mut header = [0; 13];
    header[0] = MESSAGE_DATA;
    header[1..5].copy_from_slice(&subscription.to_le_bytes());
    header[5..].copy_from_slice(&log_time_ns.to_le_bytes());
    header
}

/// Message of the time on the robot's clock, ns.
#[must_use]
pub fn time(ns: u64) -> [u8; 9] {
    let mut message = [2; 9];
    message[1..].copy_from_slice(&ns.to_le_bytes());
    message
}
