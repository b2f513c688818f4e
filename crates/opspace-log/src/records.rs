//! Records of an MCAP file that [`Recording`](crate::Recording) needs (<https://mcap.dev/spec>).
//!
//! The crate `mcap` writes the logs. It is not used for reading, because it allocates any length given in the file, up
//! to 4 GiB after one flipped bit. Here only the length of the data present is allocated.

use crate::header::Attachment;
use mcap::records::op;
use std::collections::BTreeMap;

/// Largest accepted chunk, bytes. Chunks of opspace have a quarter of a MiB, those of other tools some MiB.
const CHUNK_MAX: u64 = 64 << 20;

/// Largest record that is read, bytes: those of opspace have less than a MiB, attached paths some MiB.
const LONGEST_RECORD: u64 = 64 << 20;

/// Largest record of names and numbers that is read, bytes. In memory, each of its entries takes several times its bytes.
const LONGEST_TABLE: u64 = 4 << 20;

/// Part of a longer record that is read, bytes: it has the name of an attachment.
const BEGINNING: u64 = 4 << 10;

/// Size of opcode and length, bytes.
pub(crate) const PREFIX_BYTES: usize = 9;

/// Size of the two times with which an attachment begins, bytes.
pub(crate) const ATTACHMENT_TIMES_BYTES: u64 = 16;

/// Iterator over the records of a chunk, from a given position.
pub(crate) struct Records<'a> {
    pub bytes: &'a [u8],
    pub at: usize,
}

/// Unparsed record of the file or of a chunk.
pub(crate) struct Raw<'a> {
    pub opcode: u8,
    /// Content; only its beginning if the record is too long.
    pub body: &'a [u8],
    /// Byte offset of its beginning.
    pub at: usize,
    /// Number of bytes of the content in the file.
    pub length: u64,
}

/// Largest length of a record's content that is read, bytes.
fn longest(opcode: u8) -> u64 {
    match opcode {
        op::HEADER | op::METADATA | op::CHANNEL | op::STATISTICS | op::FOOTER | op::DATA_END => LONGEST_TABLE,
        _ => LONGEST_RECORD,
    }
}

/// Number of bytes of a record's content that are read.
pub(crate) fn read_length(opcode: u8, length: u64) -> u64 {
    if length > longest(opcode) { BEGINNING } else { length }
}

/// Parsed record.
pub(crate) enum Record<'a> {
    Header { profile: String, library: String },
    Schema { id: u16, name: String, encoding: String, data: &'a [u8] },
    Channel(ChannelRecord),
    Message(Message<'a>),
    Chunk(Chunk<'a>),
    Attachment(Attachment),
    Metadata { name: String, entries: BTreeMap<String, String> },
    Statistics(Statistics),
    DataEnd { crc: u32 },
    Footer { crc: u32 },
    Other,
}

/// Channel of a file.
pub(crate) struct ChannelRecord {
    pub id: u16,
    /// Number of its schema; 0 if it has none.
    pub schema: u16,
    pub topic: String,
    pub encoding: String,
    pub metadata: BTreeMap<String, String>,
}

/// Message of a channel.
#[derive(Clone, Copy)]
pub(crate) struct Message<'a> {
    pub channel: u16,
    pub sequence: u32,
    pub log_ns: u64,
    pub publish_ns: u64,
    pub data: &'a [u8],
}

/// Numbers of messages that the end of a file states.
#[derive(Debug)]
pub(crate) struct Statistics {
    /// Time of the last message, ns.
    pub end_ns: u64,
    /// Number of messages of each channel.
    pub messages: BTreeMap<u16, u64>,
}

/// Chunk of records, possibly compressed.
pub(crate) struct Chunk<'a> {
    size: u64,
    crc: u32,
    compression: String,
    packed: &'a [u8],
}

impl<'a> Iterator for Records<'a> {
    type Item = Result<Raw<'a>, String>;

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.at;
        let rest = &self.bytes[at..];
        if rest.is_empty() {
            return None;
        }
        let Some(raw) = first(rest, at) else {
            self.at = self.bytes.len();
            return Some(Err(format!("the file ends within the record at byte {at}")));
        };
        self.at += PREFIX_BYTES + raw.body.len();
        Some(Ok(raw))
    }
}

fn first(rest: &[u8], at: usize) -> Option<Raw<'_>> {
    let mut fields = Fields(rest);
    let opcode = fields.take::<1>()?[0];
    let length = fields.u64()?;
    Some(Raw { opcode, body: fields.bytes(length)?, at, length })
}

impl<'a> Raw<'a> {
    /// Parses the content of the record.
    pub fn parse(&self) -> Result<Record<'a>, String> {
        self.refuse_length()?;
        let broken = || format!("the record at byte {} is malformed", self.at);
        let record = self.fields().ok_or_else(broken)?;
        if self.opcode == op::ATTACHMENT {
            let (checked, crc) = self.body.split_last_chunk().ok_or_else(broken)?;
            checksum("an attachment", u32::from_le_bytes(*crc), checked)?;
        }
        Ok(record)
    }

    /// Fails if the record is longer than any that is read.
    pub fn refuse_length(&self) -> Result<(), String> {
        let Self { length, at, opcode, .. } = self;
        let most = longest(*opcode);
        if *length <= most {
            return Ok(());
        }
        Err(format!("the record at byte {at} has {length} bytes; at most {most} are read"))
    }

    /// Names a part of the log that is not made of rows, for messages about its damage.
    pub fn part(&self) -> String {
        let mut fields = Fields(self.body);
        let name = match self.opcode {
            op::ATTACHMENT => fields.take::<16>().and_then(|_times| fields.lossy_text()),
            op::METADATA => fields.lossy_text(),
            _ => None,
        };
        let kind = match self.opcode {
            op::ATTACHMENT => "attachment",
            op::METADATA => "metadata record",
            _ => "header",
        };
        name.map_or_else(|| format!("a {kind}"), |name| format!("the {kind} '{name}'"))
    }

    /// Fields of the record; `None` if it is too short for them.
    fn fields(&self) -> Option<Record<'a>> {
        let mut fields = Fields(self.body);
        Some(match self.opcode {
            op::HEADER => Record::Header { profile: fields.text()?, library: fields.text()? },
            op::SCHEMA => {
                let (id, name, encoding) = (fields.u16()?, fields.text()?, fields.text()?);
                let length = fields.u32()?;
                Record::Schema { id, name, encoding, data: fields.bytes(length.into())? }
            }
            op::CHANNEL => Record::Channel(ChannelRecord {
                id: fields.u16()?,
                schema: fields.u16()?,
                topic: fields.text()?,
                encoding: fields.text()?,
                metadata: fields.map()?,
            }),
            op::MESSAGE => Record::Message(Message {
                channel: fields.u16()?,
                sequence: fields.u32()?,
                log_ns: fields.u64()?,
                publish_ns: fields.u64()?,
                data: fields.0,
            }),
            op::STATISTICS => {
                // Numbers of messages, schemas, channels, attachments, metadata records and chunks; first time.
                let _others = fields.take::<34>()?;
                let end_ns = fields.u64()?;
                let length = fields.u32()?;
                let mut counts = Fields(fields.bytes(length.into())?);
                let mut messages = BTreeMap::new();
                while !counts.0.is_empty() {
                    messages.insert(counts.u16()?, counts.u64()?);
                }
                Record::Statistics(Statistics { end_ns, messages })
            }
            op::CHUNK => {
                let _times = fields.take::<16>()?;
                let (size, crc, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
                Record::Chunk(Chunk { size, crc, compression, packed: fields.long_bytes()? })
            }
            op::ATTACHMENT => {
                let _times = fields.take::<16>()?;
                let (name, media_type) = (fields.text()?, fields.text()?);
                Record::Attachment(Attachment::new(name, media_type, fields.long_bytes()?))
            }
            op::METADATA => Record::Metadata { name: fields.text()?, entries: fields.map()? },
            op::DATA_END => Record::DataEnd { crc: fields.u32()? },
            op::FOOTER => {
                let _places = fields.take::<16>()?;
                Record::Footer { crc: fields.u32()? }
            }
            _ => Record::Other,
        })
    }
}

impl<'a> Chunk<'a> {
    /// Size of the records, unpacked, bytes: as the file states it, which [`unpack`](Self::unpack) verifies.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Returns the records in it, after verifying their checksum.
    pub fn unpack(&self) -> Result<Vec<u8>, String> {
        if self.size > CHUNK_MAX {
            return Err(format!("a chunk of {} bytes; at most {CHUNK_MAX} are allowed", self.size));
        }
        let bytes = match self.compression.as_str() {
            "" => self.packed.to_vec(),
            "zstd" => zstd::bulk::decompress(self.packed, self.size as usize)
                .map_err(|e| format!("a chunk cannot be decompressed: {e}"))?,
            other => return Err(format!("a chunk is compressed by '{other}'; only zstd is supported")),
        };
        checksum("a chunk", self.crc, &bytes)?;
        Ok(bytes)
    }
}

/// Verifies a checksum; 0 means that none was written.
fn checksum(what: &str, saved: u32, bytes: &[u8]) -> Result<(), String> {
    compare_checksums(what, saved, crc32fast::hash(bytes))
}

/// Compares a checksum with that of the bytes as they are; 0 means that none was written.
pub(crate) fn compare_checksums(what: &str, saved: u32, actual: u32) -> Result<(), String> {
    if saved == 0 || actual == saved { Ok(()) } else { Err(format!("the checksum of {what} does not match")) }
}

/// Remaining fields of a record.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn bytes(&mut self, length: u64) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(usize::try_from(length).ok()?)?;
        self.0 = rest;
        Some(taken)
    }

    fn long_bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u64()?;
        self.bytes(length)
    }

    fn text(&mut self) -> Option<String> {
        let length = self.u32()?;
        String::from_utf8(self.bytes(length.into())?.to_vec()).ok()
    }

    /// Text for a message about damage: of limited length, whatever its bytes are.
    fn lossy_text(&mut self) -> Option<String> {
        const LONGEST: usize = 100;
        let length = self.u32()?;
        let bytes = self.bytes(length.into())?;
        Some(String::from_utf8_lossy(&bytes[..bytes.len().min(LONGEST)]).into_owned())
    }

    fn map(&mut self) -> Option<BTreeMap<String, String>> {
        let length = self.u32()?;
        let mut entries = Fields(self.bytes(length.into())?);
        let mut map = BTreeMap::new();
        while !entries.0.is_empty() {
            map.insert(entries.text()?, entries.text()?);
        }
        Some(map)
    }
}
