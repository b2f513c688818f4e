//! Records of an MCAP file that [`Recording`](crate::Recording) needs (<https://mcap.dev/spec>).
//!
//! The crate `mcap` writes the logs. It is not used for reading, because it allocates any length given in the file, up
//! to 4 GiB after one flipped bit. Here only the length of the data present is allocated.

use crate::header::Attachment;
use mcap::records::op;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Largest accepted chunk, bytes. Chunks of opspace have a quarter of a MiB, those of other tools some MiB.
const CHUNK_MAX: u64 = 64 << 20;

/// Size of opcode and length, bytes.
const PREFIX: usize = 9;

/// Iterator over the records in `bytes`, from a given position.
pub(crate) struct Records<'a> {
    pub bytes: &'a [u8],
    pub at: usize,
}

/// Unparsed record of the file or of a chunk.
pub(crate) struct Raw<'a> {
    pub opcode: u8,
    pub body: &'a [u8],
    /// Byte offset of its beginning.
    pub at: usize,
}

/// Parsed record.
pub(crate) enum Record<'a> {
    Header { library: String },
    Channel { id: u16, metadata: BTreeMap<String, String> },
    Message { channel: u16, sequence: u32, data: &'a [u8] },
    Chunk(Chunk<'a>),
    Attachment(Attachment),
    Metadata { name: String, entries: BTreeMap<String, String> },
    DataEnd { crc: u32 },
    Footer { crc: u32 },
    Other,
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
        self.at += PREFIX + raw.body.len();
        Some(Ok(raw))
    }
}

fn first(rest: &[u8], at: usize) -> Option<Raw<'_>> {
    let mut fields = Fields(rest);
    let opcode = fields.take::<1>()?[0];
    Some(Raw { opcode, body: fields.long_bytes()?, at })
}

impl<'a> Raw<'a> {
    /// Parses the content of the record.
    pub fn parse(&self) -> Result<Record<'a>, String> {
        let broken = || format!("the record at byte {} is malformed", self.at);
        let record = self.fields().ok_or_else(broken)?;
        if self.opcode == op::ATTACHMENT {
            let (checked, crc) = self.body.split_last_chunk().ok_or_else(broken)?;
            checksum("an attachment", u32::from_le_bytes(*crc), checked)?;
        }
        Ok(record)
    }

    /// Fields of the record; `None` if it is too short for them.
    fn fields(&self) -> Option<Record<'a>> {
        let mut fields = Fields(self.body);
        Some(match self.opcode {
            op::HEADER => {
                let _profile = fields.text()?;
                Record::Header { library: fields.text()? }
            }
            op::CHANNEL => {
                let (id, _schema) = (fields.u16()?, fields.u16()?);
                let (_topic, _encoding) = (fields.text()?, fields.text()?);
                Record::Channel { id, metadata: fields.map()? }
            }
            op::MESSAGE => {
                let (channel, sequence) = (fields.u16()?, fields.u32()?);
                let _times = fields.take::<16>()?;
                Record::Message { channel, sequence, data: fields.0 }
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
    pub fn unpack(&self) -> Result<Cow<'a, [u8]>, String> {
        if self.size > CHUNK_MAX {
            return Err(format!("a chunk of {} bytes; at most {CHUNK_MAX} are allowed", self.size));
        }
        let bytes = match self.compression.as_str() {
            "" => Cow::Borrowed(self.packed),
            "zstd" => {
                let unpacked = zstd::bulk::decompress(self.packed, self.size as usize);
                Cow::Owned(unpacked.map_err(|e| format!("a chunk cannot be decompressed: {e}"))?)
            }
            other => return Err(format!("a chunk is compressed by '{other}'; only zstd is supported")),
        };
        checksum("a chunk", self.crc, &bytes)?;
        Ok(bytes)
    }
}

/// Verifies a checksum; 0 means that none was written.
pub(crate) fn checksum(what: &str, saved: u32, bytes: &[u8]) -> Result<(), String> {
    if saved == 0 || crc32fast::hash(bytes) == saved {
        Ok(())
    } else {
        Err(format!("the checksum of {what} does not match"))
    }
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
