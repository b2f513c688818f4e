//! Log whose rows are read in segments.

use crate::bytes::{Bytes, FileBytes};
use crate::error::LogError;
use crate::recording::{Recording, Rows, scan};
use crate::records::{Record, Statistics};
use crate::segments::{SEGMENT_VALUES, cut, is_full};
use opspace_backend::signal_names::TICK_CHANNEL;
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Log that is read in segments: its size is not limited by memory.
#[derive(Debug)]
pub struct LogFile {
    source: Box<dyn Bytes>,
    path: PathBuf,
    recording: Recording,
    rows: Vec<Rows>,
    channels: Vec<ChannelContents>,
    statistics: Option<Statistics>,
    profile: String,
    tick: Option<u16>,
    segment_values: usize,
}

/// Messages of a channel.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ChannelContents {
    /// Topic of the channel: `/opspace/tick` for the channel `tick`.
    pub topic: String,
    /// Name of the messages' type; empty if the channel has no schema.
    pub schema: String,
    /// Number of messages.
    pub messages: u64,
    /// Size of the messages before compression, bytes.
    pub bytes: u64,
}

impl LogFile {
    /// Opens a file and reads it once.
    ///
    /// # Errors
    /// If it can't be read, or isn't a regular file, and as [`Recording::from_bytes`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, LogError> {
        let path = path.as_ref();
        Self::of(Box::new(FileBytes::open(path)?), path)
    }

    /// Reads an open file once, from its beginning; `path` is for messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_file(file: File, path: impl AsRef<Path>) -> Result<Self, LogError> {
        let path = path.as_ref();
        let bytes =
            FileBytes::new(file).map_err(|source| LogError::Read { path: path.to_owned(), source })?;
        Self::of(Box::new(bytes), path)
    }

    /// Reads a log in memory once.
    ///
    /// # Errors
    /// As [`Recording::from_bytes`].
    pub fn from_bytes(bytes: Vec<u8>) -> Result<Self, LogError> {
        Self::of(Box::new(bytes), Path::new("memory"))
    }

    fn of(source: Box<dyn Bytes>, path: &Path) -> Result<Self, LogError> {
        let mut schemas: BTreeMap<u16, String> = BTreeMap::new();
        let mut places: BTreeMap<u16, usize> = BTreeMap::new();
        let mut channels: Vec<ChannelContents> = Vec::new();
        let (mut written_with, mut tick) = (String::new(), None);
        let scanned = scan(&*source, &mut |recording, record, _| {
            match record {
                Record::Header { profile, .. } => written_with.clone_from(profile),
                Record::Schema { id, name, .. } => {
                    schemas.insert(*id, name.clone());
                }
                Record::Channel(channel) if !places.contains_key(&channel.id) => {
                    places.insert(channel.id, channels.len());
                    if channel.topic == format!("/opspace/{TICK_CHANNEL}") {
                        tick = Some(channel.id);
                    }
                    channels.push(ChannelContents {
                        topic: channel.topic.clone(),
                        schema: schemas.get(&channel.schema).cloned().unwrap_or_default(),
                        messages: 0,
                        bytes: 0,
                    });
                }
                Record::Message(message) => {
                    if let Some(channel) = places.get(&message.channel).map(|&place| &mut channels[place]) {
                        channel.messages += 1;
                        channel.bytes += message.data.len() as u64;
                    }
                    recording.keep_last_rows();
                }
                _ => {}
            }
            Ok(())
        })?;
        Ok(Self {
            source,
            path: path.to_owned(),
            recording: scanned.recording,
            rows: scanned.rows,
            channels,
            statistics: scanned.statistics,
            profile: written_with,
            tick,
            segment_values: SEGMENT_VALUES,
        })
    }

    /// Sets the number of values (8 bytes each) after which a segment ends.
    #[must_use]
    pub fn segment_values(self, values: usize) -> Self {
        Self { segment_values: values, ..self }
    }

    /// Returns layouts, attachments, metadata and damage, and the last row of each channel.
    #[must_use]
    pub fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Messages of all channels, in the order of their definition; those for viewers too.
    #[must_use]
    pub fn channels(&self) -> &[ChannelContents] {
        &self.channels
    }

    /// Number of rows of a channel, and the times of the first and the last one on the robot's clock, s.
    #[must_use]
    pub fn rows(&self, channel: &str) -> (u64, Option<[f64; 2]>) {
        let place = self.recording.channels.iter().position(|data| data.layout.channel == channel);
        place.map_or((0, None), |place| (self.rows[place].count, self.rows[place].span_s))
    }

    /// Number of rows of all channels.
    #[must_use]
    pub fn row_count(&self) -> u64 {
        self.rows.iter().map(|rows| rows.count).sum()
    }

    /// Size of the file, bytes.
    #[must_use]
    pub fn size_bytes(&self) -> u64 {
        self.source.len()
    }

    /// Reads the rows and passes them to `receive` in segments, in order, with true for the last one. The rows of one
    /// control cycle are in one segment.
    ///
    /// # Errors
    /// If the file has changed since it was opened, or can no longer be read.
    pub fn for_each_segment(&self, receive: &mut dyn FnMut(&Recording, bool)) -> Result<(), LogError> {
        let scanned = scan(&*self.source, &mut |segment, _, _| {
            if is_full(segment, self.segment_values) {
                cut(segment, receive);
            }
            Ok(())
        })?;
        receive(&scanned.recording, true);
        // Bit by bit: the time of a row may be NaN.
        let bits = |rows: &Rows| (rows.count, rows.span_s.map(|span_s| span_s.map(f64::to_bits)));
        if scanned.rows.iter().map(bits).eq(self.rows.iter().map(bits)) {
            return Ok(());
        }
        let source = io::Error::other("the file changed while it was read");
        Err(LogError::Read { path: self.path.clone(), source })
    }

    pub(crate) fn source(&self) -> &dyn Bytes {
        &*self.source
    }

    /// Profile in the header of the file.
    pub(crate) fn profile(&self) -> &str {
        &self.profile
    }

    /// Number of control cycles that the end of the file states, and the time of the last message, ns; `None` if the
    /// end is damaged.
    pub(crate) fn stated(&self) -> Option<(Option<u64>, u64)> {
        let statistics = self.statistics.as_ref()?;
        Some((self.tick.and_then(|tick| statistics.messages.get(&tick)).copied(), statistics.end_ns))
    }
}
