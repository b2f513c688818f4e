//! Bytes of a log, in memory or in a file, and the records in them.

use crate::error::LogError;
use crate::records::{ATTACHMENT_TIMES_BYTES, PREFIX_BYTES, Raw, read_length};
use mcap::records::op;
use opspace_model::files::open_file;
use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Bytes of a log, of which any part can be read.
pub(crate) trait Bytes: Send + fmt::Debug {
    /// Number of bytes.
    fn len(&self) -> u64;

    /// Fills `part` with the bytes from the offset `at` on.
    fn read_at(&self, at: u64, part: &mut [u8]) -> io::Result<()>;
}

impl Bytes for &[u8] {
    fn len(&self) -> u64 {
        <[u8]>::len(self) as u64
    }

    fn read_at(&self, at: u64, part: &mut [u8]) -> io::Result<()> {
        let rest = usize::try_from(at).ok().and_then(|at| self.get(at..));
        rest.ok_or(io::ErrorKind::UnexpectedEof)?.read_exact(part)
    }
}

impl Bytes for Vec<u8> {
    fn len(&self) -> u64 {
        self.as_slice().len() as u64
    }

    fn read_at(&self, at: u64, part: &mut [u8]) -> io::Result<()> {
        self.as_slice().read_at(at, part)
    }
}

/// File, as long as it was when it was opened.
#[derive(Debug)]
pub(crate) struct FileBytes {
    file: File,
    len: u64,
}

impl FileBytes {
    /// Opens a file.
    ///
    /// # Errors
    /// If the file can't be read, or isn't a regular file: a device or a pipe may have no end.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let failed = |source| LogError::Read { path: path.to_owned(), source };
        open_file(path).and_then(Self::new).map_err(failed)
    }

    /// Returns the bytes of an open file.
    ///
    /// # Errors
    /// If the size of the file can't be read.
    pub fn new(file: File) -> io::Result<Self> {
        let len = file.metadata()?.len();
        Ok(Self { file, len })
    }
}

impl Bytes for FileBytes {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_at(&self, at: u64, part: &mut [u8]) -> io::Result<()> {
        (&self.file).seek(SeekFrom::Start(at))?;
        (&self.file).read_exact(part)
    }
}

/// Walk over the outermost records of a log, one of which is in memory at a time.
pub(crate) struct OuterRecords<'a> {
    source: &'a dyn Bytes,
    /// Byte offset of the next record.
    at: u64,
    /// First bytes of the present record, as the file has them, its content, and its byte offset.
    prefix: [u8; PREFIX_BYTES],
    body: Vec<u8>,
    /// Number of bytes of the content in the file.
    length: u64,
    record_at: u64,
}

impl<'a> OuterRecords<'a> {
    /// Returns a walk that begins at the byte offset `at`.
    pub fn new(source: &'a dyn Bytes, at: u64) -> Self {
        Self { source, at, prefix: [0; PREFIX_BYTES], body: Vec::new(), length: 0, record_at: at }
    }

    /// Byte offset of the next record.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// Goes to the next record; `None` at the end of the file. An error ends the walk.
    pub fn advance(&mut self) -> Option<Result<(), String>> {
        let rest = self.source.len().saturating_sub(self.at);
        if rest == 0 {
            return None;
        }
        self.record_at = self.at;
        let at = self.at;
        self.at = self.source.len();
        if rest < PREFIX_BYTES as u64 {
            return Some(Err(cut(at)));
        }
        Some(self.read(at, rest - PREFIX_BYTES as u64))
    }

    /// Present record.
    pub fn record(&self) -> Raw<'_> {
        let at = self.record_at as usize;
        Raw { opcode: self.prefix[0], body: &self.body, at, length: self.length }
    }

    /// All bytes of the present record, in two parts; only the first ones of a record that is too long.
    pub fn bytes(&self) -> [&[u8]; 2] {
        [&self.prefix, &self.body]
    }

    fn read(&mut self, at: u64, rest: u64) -> Result<(), String> {
        let unreadable = |error: io::Error| format!("the file cannot be read at byte {at}: {error}");
        self.source.read_at(at, &mut self.prefix).map_err(unreadable)?;
        if self.prefix == [0; PREFIX_BYTES] {
            // A hole of a file without its data would be a long row of empty records.
            return Err(format!("the file has no record at byte {at}, only zeros"));
        }
        let [_, length @ ..] = self.prefix;
        let stated = u64::from_le_bytes(length);
        let begin = at + PREFIX_BYTES as u64;
        if self.prefix[0] == op::ATTACHMENT
            && let Some(length) = self.attachment_length(begin, rest)
            && length != stated
            && read_length(op::ATTACHMENT, length) == length
        {
            // The length of the record may be damaged while its content is intact.
            self.read_body(begin, length).map_err(unreadable)?;
            if self.is_intact_attachment() {
                self.at = begin + length;
                return Ok(());
            }
        }
        if stated > rest {
            return Err(cut(at));
        }
        self.read_body(begin, stated).map_err(unreadable)?;
        self.at = begin + stated;
        Ok(())
    }

    fn read_body(&mut self, at: u64, length: u64) -> io::Result<()> {
        self.length = length;
        self.body.resize(read_length(self.prefix[0], length) as usize, 0);
        self.source.read_at(at, &mut self.body)
    }

    /// Length of an attachment according to the lengths of its fields: times, name, media type, data and checksum.
    /// `None` if it exceeds `rest`.
    fn attachment_length(&self, begin: u64, rest: u64) -> Option<u64> {
        let mut length = ATTACHMENT_TIMES_BYTES;
        let number_at = |length: u64, number: &mut [u8]| {
            (length + number.len() as u64 <= rest)
                .then(|| self.source.read_at(begin + length, number).ok())
                .flatten()
        };
        for _name_and_media_type in 0..2 {
            let mut text = [0; size_of::<u32>()];
            number_at(length, &mut text)?;
            length += size_of::<u32>() as u64 + u64::from(u32::from_le_bytes(text));
        }
        let mut data = [0; size_of::<u64>()];
        number_at(length, &mut data)?;
        let fixed = (size_of::<u64>() + size_of::<u32>()) as u64;
        length = length.checked_add(u64::from_le_bytes(data))?.checked_add(fixed)?;
        (length <= rest).then_some(length)
    }

    fn is_intact_attachment(&self) -> bool {
        self.body.split_last_chunk().is_some_and(|(checked, crc)| {
            let crc = u32::from_le_bytes(*crc);
            crc != 0 && crc32fast::hash(checked) == crc
        })
    }
}

fn cut(at: u64) -> String {
    format!("the file ends within the record at byte {at}")
}
