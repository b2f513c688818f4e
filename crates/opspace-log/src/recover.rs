//! Recovery of the good part of a damaged log.

use crate::error::{Corruption, LogError};
use crate::file::CHUNK_BYTES;
use crate::header::TIME_ZERO_NS;
use crate::log_file::LogFile;
use crate::recording::scan;
use crate::records::Record;
use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};
use opspace_backend::signal_names::TICK_CHANNEL;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufWriter, Write};

/// Name of the metadata record of a recovered log: `damage` of the file that it was recovered from, `cycles` that were
/// saved, `lost_cycles` if their number is known, and `version` of the program that recovered it.
pub const RECOVERED: &str = "opspace.recovered";

/// Result of a recovery.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Recovery {
    /// Damage of the log; `None` if it was whole.
    pub damage: Option<Corruption>,
    /// Attachments and metadata records that were lost.
    pub lost_parts: Vec<String>,
    /// Number of control cycles saved.
    pub cycles: u64,
    /// Duration of the control cycles saved, from the first to the last, s.
    pub duration_s: f64,
    /// Number of control cycles lost; `None` if the log does not tell.
    pub lost_cycles: Option<u64>,
    /// Time from the last control cycle saved to the end of the log, s; `None` if the log does not tell.
    pub lost_s: Option<f64>,
}

impl Recovery {
    /// True if rows, attachments or metadata were lost, or may have been.
    #[must_use]
    pub fn data_lost(&self) -> bool {
        self.damage.as_ref().is_some_and(|damage| damage.rows_lost) || !self.lost_parts.is_empty()
    }
}

/// Writes the good part of a log to `sink` as a complete log: everything before the first damage of its rows, and all
/// attachments and metadata that are intact.
///
/// # Errors
/// If the sink fails, or the log can no longer be read.
pub fn recover<W: Write>(log: &LogFile, sink: W) -> Result<Recovery, LogError> {
    let mut mcap = mcap::WriteOptions::new()
        .profile(log.profile())
        .library(log.recording().library.as_str())
        .chunk_size(Some(CHUNK_BYTES as u64))
        .disable_seeking(true)
        .compression_threads(0)
        .create(NoSeek::new(BufWriter::new(sink)))?;
    let mut written = BTreeSet::new();
    scan(log.source(), &mut |recording, record, _| {
        recording.keep_last_rows();
        write(record, &mut written, &mut mcap)
    })?;
    let recovery = outcome(log);
    if let Some(damage) = &recovery.damage {
        let mut metadata = BTreeMap::from([
            ("damage".to_owned(), damage.to_string()),
            ("cycles".to_owned(), recovery.cycles.to_string()),
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ]);
        metadata.extend(recovery.lost_cycles.map(|lost| ("lost_cycles".to_owned(), lost.to_string())));
        mcap.write_metadata(&Metadata { name: RECOVERED.to_owned(), metadata })?;
    }
    mcap.finish()?;
    mcap.into_inner()
        .into_inner()
        .into_inner()
        .map_err(|e| LogError::Write(e.into_error()))?
        .flush()
        .map_err(LogError::Write)?;
    Ok(recovery)
}

fn outcome(log: &LogFile) -> Recovery {
    let recording = log.recording();
    let (cycles, span_s) = log.rows(TICK_CHANNEL);
    let [first, last] = span_s.unwrap_or_default();
    let whole = !recording.damage.as_ref().is_some_and(|damage| damage.rows_lost);
    let stated = log.stated();
    let counted = stated.and_then(|(cycles, _)| cycles);
    let end_s = stated.map(|(_, end_ns)| (end_ns as f64 - TIME_ZERO_NS as f64) * 1e-9);
    Recovery {
        damage: recording.damage.clone(),
        lost_parts: recording.damaged_parts.clone(),
        cycles,
        duration_s: last - first,
        lost_cycles: if whole { Some(0) } else { counted.map(|count| count.saturating_sub(cycles)) },
        lost_s: if whole { Some(0.0) } else { end_s.map(|end| (end - last).max(0.0)) },
    }
}

/// Writes a record; `written` has the channels that the new log defines.
fn write<W: Write>(
    record: &Record<'_>,
    written: &mut BTreeSet<u16>,
    mcap: &mut mcap::Writer<NoSeek<BufWriter<W>>>,
) -> Result<(), LogError> {
    match record {
        Record::Schema { id, name, encoding, data } => {
            mcap.add_schema_with_id(*id, name, encoding, data)?;
        }
        // A channel may be defined again in a later chunk.
        Record::Channel(channel) if written.insert(channel.id) => {
            let (topic, encoding) = (&channel.topic, &channel.encoding);
            mcap.add_channel_with_id(channel.id, channel.schema, topic, encoding, &channel.metadata)?;
        }
        Record::Message(message) => {
            let header = MessageHeader {
                channel_id: message.channel,
                sequence: message.sequence,
                log_time: message.log_ns,
                publish_time: message.publish_ns,
            };
            mcap.write_to_known_channel(&header, message.data)?;
        }
        Record::Attachment(attachment) => mcap.attach(&mcap::Attachment {
            log_time: TIME_ZERO_NS,
            create_time: 0,
            name: attachment.name.clone(),
            media_type: attachment.media_type.clone(),
            data: Cow::Borrowed(&attachment.data),
        })?,
        Record::Metadata { name, entries } => {
            mcap.write_metadata(&Metadata { name: name.clone(), metadata: entries.clone() })?;
        }
        _ => {}
    }
    Ok(())
}
