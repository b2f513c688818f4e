//! Reading of a log, or of its intact part if it is damaged.
//!
//! The file is read record by record, without its index, and a chunk's checksum is verified before its content is used.
//! If the file is incomplete or its checksum fails, row numbers are also verified, so that a chunk that is no longer
//! recognizable leaves no undetected gap.

use crate::error::{Corruption, LogError};
use crate::header::{Attachment, GAPS};
use crate::records::{Raw, Record, Records, checksum};
use crate::schema;
use mcap::MAGIC;
use mcap::records::op;
use opspace_backend::signal_names::TICK_CHANNEL;
use opspace_backend::{Layout, Signal};
use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::path::Path;

/// Largest ratio of the size of all chunks, unpacked, to that of the file: a log of a simulation without noise has
/// some 10.
const MAX_EXPANSION: u64 = 100;

/// Size of all chunks, unpacked, that is accepted of any file, bytes.
const MIN_UNPACKED_BYTES: u64 = 16 << 20;

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
    /// Damage of the file, because of which rows may be missing; `None` for an intact file.
    pub damage: Option<Corruption>,
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
        let path = path.as_ref();
        let failed = |source| LogError::Read { path: path.to_owned(), source };
        let mut file = std::fs::File::open(path).map_err(failed)?;
        let mut bytes = Vec::new();
        // The first bytes first: a device without end is none of our files.
        file.by_ref().take(MAGIC.len() as u64).read_to_end(&mut bytes).map_err(failed)?;
        if bytes != MAGIC {
            return Err(LogError::NotMcap);
        }
        file.read_to_end(&mut bytes).map_err(failed)?;
        Self::from_bytes(&bytes)
    }

    /// Reads a log from memory.
    ///
    /// # Errors
    /// If the bytes are not an MCAP file, or contain no readable channel of opspace. Other damage is reported in
    /// [`damage`](Self::damage).
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LogError> {
        if !bytes.starts_with(MAGIC) {
            return Err(LogError::NotMcap);
        }
        let whole = verify(bytes);
        let max_unpacked_bytes = MIN_UNPACKED_BYTES.max(MAX_EXPANSION * bytes.len() as u64);
        let mut reader = Reader { count_rows: whole.is_err(), max_unpacked_bytes, ..Reader::default() };
        let what = reader.read(bytes).err().or(reader.continued_after.take()).or(whole.err());
        let mut recording = reader.recording;
        let last = recording.channels.iter().filter_map(|c| c.time_s.last()).copied();
        recording.damage = what.map(|what| Corruption { what, after_s: last.reduce(f64::max) });
        if recording.channels.is_empty() {
            return Err(LogError::NoChannel { damage: recording.damage });
        }
        Ok(recording)
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

    /// Returns the signal of that name.
    #[must_use]
    pub fn signal(&self, name: &str) -> Option<Column<'_>> {
        let signals = &self.layout.signals;
        let index = signals.iter().position(|s| s.name == name)?;
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

/// Verifies that the file is complete and unchanged: it has an end, and the checksums of its data and summary sections
/// match.
fn verify(bytes: &[u8]) -> Result<(), String> {
    let mut summary = None;
    let mut records = Records { bytes, at: MAGIC.len() };
    while let Some(raw) = records.next() {
        let raw = raw?;
        if !matches!(raw.opcode, op::DATA_END | op::FOOTER) {
            continue;
        }
        match (raw.parse()?, summary) {
            (Record::DataEnd { crc }, None) => {
                checksum("the data", crc, &bytes[..raw.at])?;
                summary = Some(records.at);
            }
            (Record::Footer { crc }, Some(from)) => {
                // The checksum covers the footer up to the checksum itself.
                checksum("the summary", crc, &bytes[from..records.at - size_of::<u32>()])?;
                return if &bytes[records.at..] == MAGIC { Ok(()) } else { Err(no_end()) };
            }
            _ => return Err(no_end()),
        }
    }
    Err(no_end())
}

fn no_end() -> String {
    "the file is truncated: it has no end record".to_owned()
}

/// State of a recording while it is read.
#[derive(Default)]
struct Reader {
    recording: Recording,
    /// For each channel of the recording, the lengths of its signals and the number of its next row.
    shape: Vec<(Vec<usize>, u32)>,
    /// Map from the file's channel ids to the recording's channels; `None` for channels of other programs.
    index: HashMap<u16, Option<usize>>,
    count_rows: bool,
    /// Size of all chunks so far, unpacked.
    unpacked_bytes: u64,
    /// Largest size of all chunks, unpacked.
    max_unpacked_bytes: u64,
    /// Damage after which reading continues: a table or an attachment that can't be read.
    continued_after: Option<String>,
}

impl Reader {
    /// Reads records until one is damaged; the error describes the damage.
    fn read(&mut self, bytes: &[u8]) -> Result<(), String> {
        for raw in (Records { bytes, at: MAGIC.len() }) {
            let raw = raw?;
            match raw.opcode {
                op::DATA_END => break,
                // The rows don't depend on these records.
                op::HEADER | op::METADATA | op::ATTACHMENT => match raw.parse() {
                    Ok(record) => self.take(record)?,
                    Err(what) => self.continued_after = self.continued_after.take().or(Some(what)),
                },
                op::CHUNK => {
                    self.chunk(&raw).map_err(|what| format!("{what} (the chunk at byte {})", raw.at))?;
                }
                _ => self.take(raw.parse()?)?,
            }
        }
        Ok(())
    }

    fn chunk(&mut self, raw: &Raw<'_>) -> Result<(), String> {
        let Record::Chunk(chunk) = raw.parse()? else {
            return Ok(());
        };
        self.unpacked_bytes = self.unpacked_bytes.saturating_add(chunk.size());
        if self.unpacked_bytes > self.max_unpacked_bytes {
            let most = self.max_unpacked_bytes;
            return Err(format!(
                "the chunks expand to more than {most} bytes, which no log of this size does"
            ));
        }
        let bytes = chunk.unpack()?;
        for inner in (Records { bytes: &bytes, at: 0 }) {
            self.take(inner?.parse()?)?;
        }
        Ok(())
    }

    fn take(&mut self, record: Record<'_>) -> Result<(), String> {
        match record {
            Record::Header { library } => self.recording.library = library,
            Record::Metadata { name, entries } => self.recording.metadata.push((name, entries)),
            Record::Attachment(attachment) => self.recording.attachments.push(attachment),
            Record::Channel { id, metadata } => self.define(id, &metadata)?,
            Record::Message { channel, sequence, data } => self.message(channel, sequence, data)?,
            _ => {}
        }
        Ok(())
    }

    fn define(&mut self, id: u16, metadata: &BTreeMap<String, String>) -> Result<(), String> {
        if self.index.contains_key(&id) {
            return Ok(());
        }
        let layout = schema::layout(metadata).transpose()?;
        let place = layout.is_some().then_some(self.shape.len());
        self.index.insert(id, place);
        if let Some(layout) = layout {
            self.shape.push((schema::widths(&layout), 0));
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
        let (widths, next) = &mut self.shape[place];
        let channel = &mut self.recording.channels[place];
        let name = &channel.layout.channel;
        if self.count_rows && sequence != *next {
            return Err(format!("row {next} of channel '{name}' is missing"));
        }
        let Some(time_s) = schema::decode(widths, data, &mut channel.rows) else {
            return Err(format!("row {next} of channel '{name}' does not match the layout of the channel"));
        };
        channel.time_s.push(time_s);
        *next = next.wrapping_add(1);
        Ok(())
    }
}
