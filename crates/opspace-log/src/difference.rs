//! Comparison of two logs: of their messages, channel by channel and in order, and of their other parts.

use crate::bytes::Bytes;
use crate::error::{Corruption, LogError};
use crate::fields::{Definition, Fields};
use crate::header::TIME_ZERO_NS;
use crate::log_file::LogFile;
use crate::parts::{PartDifference, compare_parts};
use crate::recording::scan;
use crate::records::{Message, Record};
use crate::walk::{Step, Walk};
use opspace_backend::signal_names::TIMING_CHANNEL;
use std::collections::BTreeMap;

/// Comparison of two logs.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct LogComparison {
    /// Comparison of each channel: those of the first log in their order, then those that only the second log has.
    pub channels: Vec<ChannelComparison>,
    /// Differences of attachments and metadata.
    pub parts: Vec<PartDifference>,
    /// Damage of each log: messages after it, and parts that it lost, are not compared.
    pub damage: [Option<Corruption>; 2],
}

/// Comparison of the messages of a channel.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ChannelComparison {
    /// Topic of the channel.
    pub topic: String,
    /// Number of readable messages in each log; `None` if it has no such channel.
    pub messages: [Option<u64>; 2],
    /// First difference; `None` if all messages that both logs have are equal.
    pub first: Option<MessageDifference>,
    /// True for the channel of wall-clock times, which differ from run to run.
    pub wall_clock: bool,
    /// True if one log has more messages although neither is damaged.
    pub lengths_differ: bool,
}

/// First difference between the messages of a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct MessageDifference {
    /// Number of the message in its channel, from 0.
    pub message: u64,
    /// Time of the message in the first log, on the robot's clock, ns.
    pub time_ns: i64,
    /// Path of the field, for example `torque_desired.elbow`; `log_time` if the times differ.
    pub field: String,
    /// Value in each log; `None` where the field is absent.
    pub values: [Option<String>; 2],
}

impl ChannelComparison {
    /// True if the channel differs.
    #[must_use]
    pub fn differs(&self) -> bool {
        self.first.is_some() || self.lengths_differ || self.messages.contains(&None)
    }
}

impl LogComparison {
    /// True if a channel differs other than that of wall-clock times, or an attachment or metadata.
    #[must_use]
    pub fn differs(&self) -> bool {
        !self.parts.is_empty() || self.channels.iter().any(|channel| channel.differs() && !channel.wall_clock)
    }

    /// True if a log is damaged: what could be compared says nothing about the rest.
    #[must_use]
    pub fn is_damaged(&self) -> bool {
        self.damage.iter().any(Option::is_some)
    }
}

/// Compares every message of every channel of two logs, their attachments and their metadata. One unpacked chunk of each is in memory at a time.
///
/// # Errors
/// If a log can no longer be read, with its index: 0 or 1.
pub fn compare_logs(first: &LogFile, second: &LogFile) -> Result<LogComparison, (usize, LogError)> {
    let logs = [Log::new(first).map_err(|e| (0, e))?, Log::new(second).map_err(|e| (1, e))?];
    let mut topics: Vec<&String> = logs[0].topics.iter().collect();
    topics.extend(logs[1].topics.iter().filter(|topic| !logs[0].topics.contains(topic)));
    let channels = topics.into_iter().map(|topic| compare(topic, &logs)).collect();
    let [one, other] = logs;
    let parts = compare_parts([first.recording(), second.recording()]);
    Ok(LogComparison { channels, parts, damage: [one.damage, other.damage] })
}

/// Log and the definitions of its channels.
struct Log<'a> {
    source: &'a dyn Bytes,
    topics: Vec<String>,
    channels: BTreeMap<u16, (String, Option<Definition>)>,
    /// Number of readable messages of each topic.
    counts: BTreeMap<String, u64>,
    damage: Option<Corruption>,
}

impl<'a> Log<'a> {
    fn new(file: &'a LogFile) -> Result<Self, LogError> {
        let mut schemas = BTreeMap::new();
        let (mut topics, mut counts) = (Vec::new(), BTreeMap::new());
        let mut channels: BTreeMap<u16, (String, Option<Definition>)> = BTreeMap::new();
        scan(file.source(), &mut |recording, record, _| {
            recording.keep_last_rows();
            match record {
                Record::Schema { id, name, encoding, data } => {
                    let definition = (encoding == "protobuf").then(|| Definition::protobuf(name, data));
                    schemas.insert(*id, (name.clone(), data.to_vec(), definition.flatten().is_some()));
                }
                Record::Channel(channel) if !channels.contains_key(&channel.id) => {
                    let schema = schemas.get(&channel.schema).filter(|(.., readable)| *readable);
                    let definition = schema.and_then(|(name, data, _)| Definition::protobuf(name, data));
                    channels.insert(channel.id, (channel.topic.clone(), definition));
                    if counts.insert(channel.topic.clone(), 0).is_none() {
                        topics.push(channel.topic.clone());
                    }
                }
                Record::Message(message) => {
                    let topic = channels.get(&message.channel).map(|(topic, _)| topic);
                    if let Some(count) = topic.and_then(|topic| counts.get_mut(topic)) {
                        *count += 1;
                    }
                }
                _ => {}
            }
            Ok(())
        })?;
        let damage = file.recording().damage.clone();
        Ok(Self { source: file.source(), topics, channels, counts, damage })
    }

    fn definition(&self, channel: u16) -> Option<&Definition> {
        self.channels.get(&channel).and_then(|(_, definition)| definition.as_ref())
    }
}

/// Messages of a topic, in order.
struct Messages<'l, 'a> {
    log: &'l Log<'a>,
    topic: &'l str,
    walk: Walk<'a>,
    left: u64,
}

impl<'l, 'a> Messages<'l, 'a> {
    fn new(log: &'l Log<'a>, topic: &'l str) -> Self {
        let left = log.counts.get(topic).copied().unwrap_or(0);
        Self { log, topic, walk: Walk::new(log.source), left }
    }

    /// Calls `f` with the next message, and returns its result; `None` at the end of the readable messages.
    fn next<R>(&mut self, f: impl FnOnce(Message<'_>) -> R) -> Option<R> {
        while self.left > 0 {
            if let Ok(Step::Record(Record::Message(message), _)) = self.walk.next()? {
                let topic = self.log.channels.get(&message.channel).map(|(topic, _)| topic.as_str());
                if topic == Some(self.topic) {
                    self.left -= 1;
                    return Some(f(message));
                }
            }
        }
        None
    }
}

fn compare(topic: &str, logs: &[Log<'_>; 2]) -> ChannelComparison {
    let messages = [0, 1].map(|k| logs[k].counts.get(topic).copied());
    let whole = logs.iter().all(|log| !log.damage.as_ref().is_some_and(|damage| damage.rows_lost));
    let [mut one, mut other] = [0, 1].map(|k| Messages::new(&logs[k], topic));
    let (mut number, mut first) = (0, None);
    while let Some(Some(difference)) = one.next(|a| other.next(|b| difference(logs, a, b))) {
        if let Some((field, values, time_ns)) = difference {
            first = Some(MessageDifference { message: number, time_ns, field, values });
            break;
        }
        number += 1;
    }
    ChannelComparison {
        topic: topic.to_owned(),
        messages,
        first,
        wall_clock: topic == format!("/opspace/{TIMING_CHANNEL}"),
        lengths_differ: whole && messages[0] != messages[1],
    }
}

/// First field that differs, its values, and the time of the message.
fn difference(
    logs: &[Log<'_>; 2],
    a: Message<'_>,
    b: Message<'_>,
) -> Option<(String, [Option<String>; 2], i64)> {
    let since_zero = |ns: u64| ns.cast_signed().wrapping_sub(TIME_ZERO_NS.cast_signed());
    let at = since_zero(a.log_ns);
    for (name, one, other) in [("log_time", a.log_ns, b.log_ns), ("publish_time", a.publish_ns, b.publish_ns)]
    {
        if one != other {
            let seconds = |ns| Some(format!("{:?} s", since_zero(ns) as f64 * 1e-9));
            return Some((name.to_owned(), [seconds(one), seconds(other)], at));
        }
    }
    if a.data == b.data {
        return None;
    }
    let fields = |log: &Log<'_>, message: Message<'_>| log.definition(message.channel)?.fields(message.data);
    match (fields(&logs[0], a), fields(&logs[1], b)) {
        (Some(one), Some(other)) => differing_field(one, other).map(|(field, values)| (field, values, at)),
        _ => {
            let byte = a.data.iter().zip(b.data).take_while(|(a, b)| a == b).count();
            let value = |data: &[u8]| data.get(byte).map(|byte| format!("{byte:#04x}"));
            Some((format!("byte {byte}"), [value(a.data), value(b.data)], at))
        }
    }
}

fn differing_field(one: Fields, other: Fields) -> Option<(String, [Option<String>; 2])> {
    let same = one.iter().zip(&other).take_while(|(a, b)| a == b).count();
    let [a, b] = [&one, &other].map(|fields| fields.get(same).cloned());
    match (a, b) {
        (None, None) => None,
        (Some((path, a)), Some((there, b))) if path == there => Some((path, [Some(a), Some(b)])),
        // A field is absent in one of the messages: in the second one if it comes later in the first one.
        (Some((path, a)), b) if !other[same..].iter().any(|(there, _)| *there == path) || b.is_none() => {
            Some((path, [Some(a), None]))
        }
        (_, Some((path, b))) => Some((path, [None, Some(b)])),
        (Some((path, a)), None) => Some((path, [Some(a), None])),
    }
}
