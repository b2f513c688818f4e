//! Reading of a log, or of its intact part if it is damaged.
//!
//! The file is read record by record, without its index, and a chunk's checksum is verified before its content is used.
//! If the file is incomplete or its checksum fails, row numbers are also verified, so that a chunk that is no longer
//! recognizable leaves no undetected gap.

use crate::bytes::{Bytes, FileBytes};
use crate::error::{Corruption, LogError};
use crate::header::{Attachment, GAPS};
use crate::records::{Record, Statistics};
use crate::schema::{self, Shape};
use crate::walk::{Step, Stop, Verified, Walk, verify};
use mcap::MAGIC;
use opspace_backend::signal_names::TICK_CHANNEL;
use opspace_backend::{Layout, Signal};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Largest memory of all attachments, tables and definitions of a log together, bytes: a task with its recorded paths has some MiB.
const MAX_PARTS_BYTES: u64 = 64 << 20;

/// Largest ratio of the memory that all rows need to the size of their chunks. A number that is absent takes no byte in the
/// file, and one that does not change takes few: logs of runs have ratios of 2 to 5, a log of a robot whose every number is
/// constant, and most absent, some 50.
const MAX_ROW_EXPANSION: u64 = 128;

/// Memory of all rows that is accepted of any file, bytes.
const MIN_ROW_BYTES: u64 = 64 << 20;

/// Log in memory.
#[derive(Clone, Debug, Default)]
pub struct Recording {
    /// Recorded channels, in the order of recording.
    pub channels: Vec<ChannelData>,
    /// Files within the log.
    pub attachments: Vec<Attachment>,
    /// Named tables. Only the checksum of the whole file protects them: don't rely on those of a damaged file.
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    /// Library that wrote the log.
    pub library: String,
    /// Attachments and metadata records that are damaged and therefore missing here: `the attachment 'task.toml'`.
    pub damaged_parts: Vec<String>,
    /// Damage of the file; `None` for an intact file.
    pub damage: Option<Corruption>,
    /// True if the file has an end, that is, if it was closed by its writer.
    pub closed: bool,
}

/// Rows of a channel.
#[derive(Clone, Debug)]
pub struct ChannelData {
    /// Layout of a row.
    pub layout: Layout,
    /// Time of each row on the robot's clock, s.
    pub time_s: Vec<f64>,
    /// All rows, concatenated.
    pub rows: Vec<f64>,
}

/// Receiver of the records of a log, each with the byte offset of it or of its chunk. The recording has the rows up to
/// this record; the receiver may remove rows.
pub(crate) type Accept<'f> = dyn FnMut(&mut Recording, &Record<'_>, usize) -> Result<(), LogError> + 'f;

/// Result of a walk through a log.
pub(crate) struct Scan {
    /// Everything that the receiver of the records has not removed.
    pub recording: Recording,
    /// Rows of each channel, which may have been removed.
    pub rows: Vec<Rows>,
    /// Numbers of messages that the end of the file states, if it is intact.
    pub statistics: Option<Statistics>,
}

/// Rows of a channel of a log.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Rows {
    /// Number of rows.
    pub count: u64,
    /// Times of the first and the last row, s.
    pub span_s: Option<[f64; 2]>,
}

/// Signal of a channel, over all rows.
#[derive(Clone, Copy, Debug)]
pub struct Column<'a> {
    data: &'a ChannelData,
    signal: &'a Signal,
    offset: usize,
    stride: usize,
}

impl Recording {
    /// Reads a file.
    ///
    /// # Errors
    /// If it can't be read, or [`from_bytes`](Self::from_bytes) fails.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, LogError> {
        Self::of(&FileBytes::open(path.as_ref())?)
    }

    /// Reads a log from memory.
    ///
    /// # Errors
    /// If the bytes are not an MCAP file, or contain no readable channel of opspace. Other damage is reported in
    /// [`damage`](Self::damage).
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LogError> {
        Self::of(&bytes)
    }

    fn of(source: &dyn Bytes) -> Result<Self, LogError> {
        scan(source, &mut |_, _, _| Ok(())).map(|scan| scan.recording)
    }

    /// Removes all rows but the last one of each channel.
    pub(crate) fn keep_last_rows(&mut self) {
        for channel in self.channels.iter_mut().filter(|channel| channel.len() > 1) {
            channel.time_s.drain(..channel.time_s.len() - 1);
            channel.rows.drain(..channel.rows.len() - channel.layout.width());
        }
    }

    /// Returns the channel of that name.
    #[must_use]
    pub fn channel(&self, name: &str) -> Option<&ChannelData> {
        self.channels.iter().find(|c| c.layout.channel == name)
    }

    /// Returns the channel of the control loop.
    ///
    /// # Errors
    /// If the log lacks it.
    pub fn tick(&self) -> Result<&ChannelData, LogError> {
        self.channel(TICK_CHANNEL).ok_or_else(|| LogError::NoSignal { name: TICK_CHANNEL.to_owned() })
    }

    /// Returns the attached file of that name.
    #[must_use]
    pub fn attachment(&self, name: &str) -> Option<&Attachment> {
        self.attachments.iter().find(|a| a.name == name)
    }

    /// Returns the table of that name.
    #[must_use]
    pub fn metadata(&self, name: &str) -> Option<&BTreeMap<String, String>> {
        self.metadata.iter().find(|(n, _)| n == name).map(|(_, entries)| entries)
    }

    /// Number of rows that the recorder had to drop.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.metadata(GAPS).and_then(|gaps| gaps.get("records")?.parse().ok()).unwrap_or(0)
    }
}

impl ChannelData {
    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// True if there are no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// Returns the row at index `k`, all signals.
    ///
    /// # Panics
    /// If `k` isn't below the number of rows.
    #[must_use]
    pub fn row(&self, k: usize) -> &[f64] {
        let width = self.layout.width();
        &self.rows[k * width..(k + 1) * width]
    }

    /// Returns the signal of that name; `None` if there is no such signal, or it has no element.
    #[must_use]
    pub fn signal(&self, name: &str) -> Option<Column<'_>> {
        let signals = &self.layout.signals;
        let index = signals.iter().position(|s| s.name == name && !s.is_empty())?;
        let offset = signals[..index].iter().map(Signal::len).sum();
        Some(Column { data: self, signal: &signals[index], offset, stride: self.layout.width() })
    }
}

impl<'a> Column<'a> {
    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.data.len()
    }

    /// True if there are no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    /// Returns the signal in row `k`, one number per element.
    ///
    /// # Panics
    /// If `k` isn't below the number of rows.
    #[must_use]
    pub fn row(&self, k: usize) -> &'a [f64] {
        let start = k * self.stride + self.offset;
        &self.data.rows[start..start + self.signal.len()]
    }

    /// Returns the signal in each row.
    pub fn rows(self) -> impl ExactSizeIterator<Item = &'a [f64]> {
        (0..self.len()).map(move |k| self.row(k))
    }

    /// Names of the elements.
    #[must_use]
    pub fn elements(&self) -> &'a [String] {
        &self.signal.elements
    }

    /// SI unit of each element.
    #[must_use]
    pub fn units(&self) -> &'a [String] {
        &self.signal.units
    }

    /// SI unit, as [`Signal::unit`].
    #[must_use]
    pub fn unit(&self) -> String {
        self.signal.unit()
    }
}

/// Walks through a log and passes each record up to the damage, if there is any, to `accept`.
///
/// # Errors
/// As [`Recording::from_bytes`], and errors of `accept`.
pub(crate) fn scan(source: &dyn Bytes, accept: &mut Accept<'_>) -> Result<Scan, LogError> {
    let mut magic = [0; MAGIC.len()];
    if source.read_at(0, &mut magic).is_err() || magic != MAGIC {
        return Err(LogError::NotMcap);
    }
    let Verified { problem, statistics, closed } = verify(source);
    let mut reader = Reader { count_rows: problem.is_some(), ..Reader::default() };
    let stop = reader.read(source, accept)?;
    let rows_lost = stop.is_some() || !reader.is_complete(statistics.as_ref());
    let part = reader.damaged_part.take();
    let found = stop.map(|stop| (stop.what, Some(stop.at))).or(part).or(problem);
    let mut recording = reader.recording;
    let rows: Vec<Rows> = reader.tracks.into_iter().map(|track| track.rows).collect();
    let after_s = rows.iter().filter_map(|rows| Some(rows.span_s?[1])).reduce(f64::max);
    recording.damage = found.map(|(what, at)| Corruption { what, after_s, rows_lost, at_byte: at });
    recording.closed = closed;
    if recording.channels.is_empty() {
        return Err(LogError::NoChannel { damage: recording.damage });
    }
    Ok(Scan { recording, rows, statistics })
}

/// State of a recording while it is read.
#[derive(Default)]
struct Reader {
    recording: Recording,
    /// State of each channel of the recording.
    tracks: Vec<Track>,
    /// Name, encoding and content of each schema so far.
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    /// Map from the file's channel ids to the recording's channels; `None` for channels of other programs.
    index: HashMap<u16, Option<usize>>,
    count_rows: bool,
    /// Size of all rows so far, and the largest one that is accepted, bytes.
    row_bytes: u64,
    max_row_bytes: u64,
    /// Size of all attachments, tables and definitions so far, bytes.
    part_bytes: u64,
    /// First damage after which reading continues, with its byte offset.
    damaged_part: Option<(String, Option<usize>)>,
}

/// State of a channel while it is read.
struct Track {
    /// Forms of the channel's signals.
    shapes: Vec<Shape>,
    /// Number of the next row, as messages have it.
    next: u32,
    rows: Rows,
}

impl Reader {
    /// Reads records until one is damaged, and returns that damage.
    fn read(&mut self, source: &dyn Bytes, accept: &mut Accept<'_>) -> Result<Option<Stop>, LogError> {
        let mut walk = Walk::new(source);
        loop {
            self.max_row_bytes = MIN_ROW_BYTES.max(MAX_ROW_EXPANSION.saturating_mul(walk.packed_bytes()));
            let (record, at) = match walk.next() {
                None => return Ok(None),
                Some(Err(stop)) => return Ok(Some(stop)),
                Some(Ok(Step::Damaged { part, what, at })) => {
                    self.damaged_part
                        .get_or_insert_with(|| (format!("{part} at byte {at} is damaged: {what}"), Some(at)));
                    self.recording.damaged_parts.push(part);
                    continue;
                }
                Some(Ok(Step::Record(record, at))) => (record, at),
            };
            self.part_bytes += self.new_part_bytes(&record);
            if self.part_bytes > MAX_PARTS_BYTES {
                let what = format!(
                    "the attachments, tables and definitions need more than {MAX_PARTS_BYTES} bytes of memory"
                );
                return Ok(Some(Stop { what, at }));
            }
            if let Err(what) = self.take(&record) {
                return Ok(Some(Stop { what, at }));
            }
            accept(&mut self.recording, &record, at)?;
        }
    }

    /// True if the file's own statistics confirm that every row was read.
    fn is_complete(&self, statistics: Option<&Statistics>) -> bool {
        statistics.is_some_and(|statistics| {
            let mut own = self.index.iter().filter_map(|(id, place)| place.map(|place| (id, place)));
            own.all(|(id, place)| {
                statistics.messages.get(id).copied().unwrap_or(0) == self.tracks[place].rows.count
            })
        })
    }

    /// Memory that a record needs which is no row, bytes. A definition may be repeated, and needs it once.
    fn new_part_bytes(&self, record: &Record<'_>) -> u64 {
        /// Memory of an entry of a table beside its text, bytes.
        const ENTRY: usize = 64;
        let table = |entries: &BTreeMap<String, String>| {
            entries.iter().map(|(key, value)| ENTRY + key.len() + value.len()).sum::<usize>()
        };
        let bytes = match record {
            Record::Attachment(attachment) => attachment.data.len(),
            Record::Metadata { name, entries } => ENTRY + name.len() + table(entries),
            Record::Channel(channel) if !self.index.contains_key(&channel.id) => {
                ENTRY + channel.topic.len() + table(&channel.metadata)
            }
            Record::Schema { id, name, data, .. } if !self.schemas.contains_key(id) => {
                ENTRY + name.len() + <[u8]>::len(data)
            }
            _ => 0,
        };
        bytes as u64
    }

    fn take(&mut self, record: &Record<'_>) -> Result<(), String> {
        match record {
            Record::Header { library, .. } => self.recording.library.clone_from(library),
            Record::Metadata { name, entries } => {
                self.recording.metadata.push((name.clone(), entries.clone()));
            }
            Record::Attachment(attachment) => self.recording.attachments.push(attachment.clone()),
            Record::Schema { id, name, encoding, data } => {
                let definition = (name.clone(), encoding.clone(), data.to_vec());
                if *self.schemas.entry(*id).or_insert_with(|| definition.clone()) != definition {
                    return Err(format!("schema {id} is defined twice, differently"));
                }
            }
            Record::Channel(channel) => {
                // 0 is no schema.
                if channel.schema != 0 && !self.schemas.contains_key(&channel.schema) {
                    let (topic, schema) = (&channel.topic, channel.schema);
                    return Err(format!(
                        "channel '{topic}' has schema {schema}, which is not defined before it"
                    ));
                }
                self.define(channel.id, &channel.metadata)?;
            }
            Record::Message(message) => self.message(message.channel, message.sequence, message.data)?,
            _ => {}
        }
        Ok(())
    }

    fn define(&mut self, id: u16, metadata: &BTreeMap<String, String>) -> Result<(), String> {
        if self.index.contains_key(&id) {
            return Ok(());
        }
        let layout = schema::layout(metadata).transpose()?;
        let place = layout.is_some().then_some(self.tracks.len());
        self.index.insert(id, place);
        if let Some((layout, shapes)) = layout {
            self.tracks.push(Track { shapes, next: 0, rows: Rows::default() });
            let data = ChannelData { layout, time_s: Vec::new(), rows: Vec::new() };
            self.recording.channels.push(data);
        }
        Ok(())
    }

    fn message(&mut self, id: u16, sequence: u32, data: &[u8]) -> Result<(), String> {
        let Some(place) = self.index.get(&id) else {
            return Err(format!("a message of channel {id}, for which there is no channel record"));
        };
        let Some(place) = *place else {
            return Ok(());
        };
        let Track { shapes, next, rows } = &mut self.tracks[place];
        let channel = &mut self.recording.channels[place];
        let name = &channel.layout.channel;
        if self.count_rows && sequence != *next {
            return Err(format!("row {next} of channel '{name}' is missing"));
        }
        self.row_bytes += (size_of::<f64>() * (1 + channel.layout.width())) as u64;
        if self.row_bytes > self.max_row_bytes {
            let most = self.max_row_bytes;
            return Err(format!(
                "the rows need more than {most} bytes of memory, which no log of this size does"
            ));
        }
        let Some(time_s) = schema::decode(shapes, data, &mut channel.rows) else {
            return Err(format!("row {next} of channel '{name}' does not match the layout of the channel"));
        };
        channel.time_s.push(time_s);
        *next = next.wrapping_add(1);
        rows.count += 1;
        rows.span_s = Some([rows.span_s.map_or(time_s, |[first, _]| first), time_s]);
        Ok(())
    }
}
