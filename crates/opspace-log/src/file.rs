//! MCAP file that the writer's thread writes.
//!
//! Bytes are only appended, in whole chunks, so that a truncated file is an intact prefix followed by a part of one
//! chunk. Attachments, metadata and all definitions come first. The file doesn't depend on the wall clock, except for
//! the ends of chunks in a real-time run.

use crate::error::LogError;
use crate::foxglove::{Encode, Kind, Message, Warning};
use crate::header::{Channel, GAPS, Header, LOG, TIME_ZERO_NS};
use crate::outcome::{OUTCOME, OutcomeRecord};
use crate::schema::{self, Shape};
use crate::viewer::{Viewer, nanoseconds, warning};
use crate::viewer_receiver::{ViewerReceiver, ViewerTopic};
use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};
use opspace_backend::Layout;
use serde_json::{Value, json};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{BufWriter, Write};

/// Size at which a chunk is closed, bytes: large enough to compress well, small enough to limit a loss.
pub(crate) const CHUNK_BYTES: usize = 256 * 1024;

/// Duration on the robot's clock after which a chunk is closed, ns: the largest loss if a run is killed.
const CHUNK_NS: u64 = 1_000_000_000;

/// Number of gaps listed individually; further gaps are only counted.
const LISTED_GAPS: usize = 1000;

/// Topic of the file.
struct Topic {
    id: u16,
    sequence: u32,
}

/// Gap of dropped rows.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Gap {
    /// Number of rows dropped.
    pub records: u64,
    /// Time of the first dropped row, s.
    pub from_s: f64,
    /// Time of the last dropped row, s.
    pub to_s: f64,
}

pub(crate) struct File<W: Write> {
    mcap: mcap::Writer<NoSeek<BufWriter<W>>>,
    rows: Vec<(Topic, Vec<Shape>)>,
    viewer: Option<(Viewer, Vec<Topic>)>,
    receivers: Vec<Box<dyn ViewerReceiver>>,
    log: Topic,
    /// Size of the messages in the open chunk, bytes; and the time of the first one.
    chunk_bytes: usize,
    chunk_from_ns: u64,
    message: Vec<u8>,
    gaps: Vec<Gap>,
    lost: u64,
    last_s: f64,
}

impl<W: Write> File<W> {
    /// Writes the header and all definitions, which are known before the run. `receivers` get what viewers see.
    pub fn create(
        sink: W,
        header: Header,
        channels: &[Channel],
        mut receivers: Vec<Box<dyn ViewerReceiver>>,
    ) -> Result<Self, LogError> {
        let layouts: Vec<&Layout> = channels.iter().map(|c| &c.layout).collect();
        let viewer = Viewer::new(&layouts, header.model, header.scene)?;
        let shown: Vec<ViewerTopic> = viewer.iter().flat_map(Viewer::topics).map(described).collect();
        receivers.iter_mut().for_each(|receiver| receiver.begin(&shown, &layouts));
        let mut mcap = mcap::WriteOptions::new()
            .profile("opspace")
            .library(concat!("opspace ", env!("CARGO_PKG_VERSION")))
            .chunk_size(None)
            .disable_seeking(true)
            .compression_threads(0)
            .create(NoSeek::new(BufWriter::new(sink)))?;
        let own = (LOG.to_owned(), own_metadata());
        for (name, metadata) in std::iter::once(own).chain(header.metadata) {
            mcap.write_metadata(&Metadata { name, metadata })?;
        }
        for attachment in header.attachments {
            mcap.attach(&mcap::Attachment {
                log_time: TIME_ZERO_NS,
                create_time: 0,
                name: attachment.name,
                media_type: attachment.media_type,
                data: Cow::Owned(attachment.data),
            })?;
        }
        let mut rows = Vec::new();
        for layout in layouts {
            let (name, data) = schema::definition(layout);
            let schema = mcap.add_schema(&name, "protobuf", &data)?;
            let topic = format!("/opspace/{}", layout.channel);
            let id = mcap.add_channel(schema, &topic, "protobuf", &schema::channel_metadata(layout))?;
            rows.push((Topic { id, sequence: 0 }, schema::shapes(layout)));
        }
        let viewer = match viewer {
            None => None,
            Some(viewer) => {
                let topics = viewer.topics().iter().map(|(topic, kind)| add_topic(&mut mcap, topic, kind));
                let topics = topics.collect::<Result<_, _>>()?;
                Some((viewer, topics))
            }
        };
        let log = add_topic(&mut mcap, "/log", &Warning::KIND)?;
        mcap.flush()?;
        Ok(Self {
            mcap,
            rows,
            viewer,
            receivers,
            log,
            chunk_bytes: 0,
            chunk_from_ns: 0,
            message: Vec::new(),
            gaps: Vec::new(),
            lost: 0,
            last_s: 0.0,
        })
    }

    /// Writes a row, and the viewers' messages computed from it.
    pub fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) -> Result<(), LogError> {
        let ns = nanoseconds(time_s);
        self.last_s = time_s;
        if self.chunk_bytes > 0
            && (self.chunk_bytes >= CHUNK_BYTES || ns.abs_diff(self.chunk_from_ns) >= CHUNK_NS)
        {
            self.close_chunk()?;
        }
        if self.chunk_bytes == 0 {
            self.chunk_from_ns = ns;
        }
        let (topic, shapes) = &mut self.rows[channel];
        self.message.clear();
        schema::encode(shapes, time_s, row, &mut self.message);
        self.chunk_bytes += put(&mut self.mcap, topic, ns, &self.message)?;
        self.receivers.iter_mut().for_each(|receiver| receiver.row(channel, time_s, row));
        let Self { viewer: Some((viewer, topics)), mcap, message, chunk_bytes, receivers, .. } = self else {
            return Ok(());
        };
        viewer.show(channel, ns, row, &mut |topic, shown| {
            encode(shown, message);
            receivers.iter_mut().for_each(|receiver| receiver.message(topic, ns, message));
            *chunk_bytes += put(mcap, &mut topics[topic], ns, message)?;
            Ok(())
        })
    }

    /// Records a gap of dropped rows.
    pub fn gap(&mut self, gap: Gap) -> Result<(), LogError> {
        self.lost += gap.records;
        if self.gaps.len() < LISTED_GAPS {
            self.gaps.push(gap);
        }
        let ns = nanoseconds(gap.to_s);
        let text =
            format!("{} records were dropped from t = {} s to {} s", gap.records, gap.from_s, gap.to_s);
        encode(&warning(ns, text), &mut self.message);
        self.chunk_bytes += put(&mut self.mcap, &mut self.log, ns, &self.message)?;
        Ok(())
    }

    /// Closes the open chunk and passes it to the operating system.
    pub fn close_chunk(&mut self) -> Result<(), LogError> {
        if self.chunk_bytes > 0 {
            self.chunk_bytes = 0;
            self.mcap.flush()?;
        }
        Ok(())
    }

    /// Writes the gaps, the outcome and the footer; `dropped` is the number of all lost records.
    pub fn finish(mut self, dropped: u64, outcome: Option<&OutcomeRecord>) -> Result<W, LogError> {
        let untold = dropped.saturating_sub(self.lost);
        if untold > 0 {
            self.gap(Gap { records: untold, from_s: self.last_s, to_s: self.last_s })?;
        }
        if self.lost > 0 {
            let gap = |g: &Gap| json!({ "from_s": g.from_s, "to_s": g.to_s, "records": g.records });
            let gaps: Value = self.gaps.iter().map(gap).collect();
            let records = self.lost.to_string();
            let metadata =
                BTreeMap::from([("gaps".to_owned(), gaps.to_string()), ("records".to_owned(), records)]);
            self.mcap.write_metadata(&Metadata { name: GAPS.to_owned(), metadata })?;
        }
        if let Some(outcome) = outcome {
            let metadata = outcome.entries();
            self.mcap.write_metadata(&Metadata { name: OUTCOME.to_owned(), metadata })?;
        }
        self.mcap.finish()?;
        let buffer = self.mcap.into_inner().into_inner();
        buffer.into_inner().map_err(|e| LogError::Write(e.into_error()))
    }
}

fn own_metadata() -> BTreeMap<String, String> {
    let clock =
        "log_time and publish_time are the robot's clock plus time_zero_ns; field t of a row is exact";
    let entries = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("time_zero_ns", TIME_ZERO_NS.to_string()),
        ("clock", clock.to_owned()),
    ];
    entries.into_iter().map(|(k, v)| (k.to_owned(), v)).collect()
}

/// Describes a topic for receivers.
fn described((topic, kind): &(String, Kind)) -> ViewerTopic {
    let [definition, messages] = kind.encodings;
    ViewerTopic {
        topic: topic.clone(),
        encoding: messages.to_owned(),
        schema_name: kind.name.to_owned(),
        schema_encoding: definition.to_owned(),
        schema: kind.definition.to_vec(),
    }
}

/// Adds a topic of a message type for viewers.
fn add_topic<W: Write>(
    mcap: &mut mcap::Writer<NoSeek<W>>,
    topic: &str,
    kind: &Kind,
) -> Result<Topic, LogError> {
    let [definition, messages] = kind.encodings;
    let schema = mcap.add_schema(kind.name, definition, kind.definition)?;
    let id = mcap.add_channel(schema, topic, messages, &BTreeMap::new())?;
    Ok(Topic { id, sequence: 0 })
}

fn encode(message: &dyn Encode, out: &mut Vec<u8>) {
    out.clear();
    message.encode(out);
}

/// Writes a message and returns its length.
fn put<W: Write>(
    mcap: &mut mcap::Writer<NoSeek<W>>,
    topic: &mut Topic,
    ns: u64,
    data: &[u8],
) -> Result<usize, LogError> {
    let header =
        MessageHeader { channel_id: topic.id, sequence: topic.sequence, log_time: ns, publish_time: ns };
    topic.sequence = topic.sequence.wrapping_add(1);
    mcap.write_to_known_channel(&header, data)?;
    Ok(data.len())
}
