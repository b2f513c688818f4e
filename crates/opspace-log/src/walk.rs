//! Walk through the records of a file, also of those in chunks, with one unpacked chunk in memory at a time.

use crate::records::{Raw, Record, Records, Statistics, checksum};
use mcap::MAGIC;
use mcap::records::op;
use std::borrow::Cow;

/// Largest ratio of the size of all chunks, unpacked, to that of the file: a log of a simulation without noise has
/// some 10.
const MAX_EXPANSION: u64 = 100;

/// Size of all chunks, unpacked, that is accepted of any file, bytes.
const MIN_UNPACKED_BYTES: u64 = 16 << 20;

/// Records of a file up to its end record, in order.
pub(crate) struct Walk<'a> {
    outer: Records<'a>,
    chunk: Cow<'a, [u8]>,
    within: usize,
    chunk_at: usize,
    /// Size of all chunks so far, unpacked.
    unpacked_bytes: u64,
    /// Largest size of all chunks, unpacked.
    max_unpacked_bytes: u64,
}

/// Record, or a damaged part on which the rows do not depend.
pub(crate) enum Step<'b> {
    /// Record, with the byte offset of it or of its chunk.
    Record(Record<'b>, usize),
    /// Attachment, metadata record or header that is damaged; the walk continues after it.
    Damaged {
        /// Name of the part: `the attachment 'task.toml'`.
        part: String,
        /// Description of the damage.
        what: String,
        /// Byte offset.
        at: usize,
    },
}

/// Damage on which later rows depend.
#[derive(Debug)]
pub(crate) struct Stop {
    pub what: String,
    /// Byte offset at which the damaged record begins.
    pub at: usize,
}

impl<'a> Walk<'a> {
    /// Returns a walk through a file, which begins with the magic bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self {
            outer: Records { bytes, at: MAGIC.len() },
            chunk: Cow::Borrowed(&[]),
            within: 0,
            chunk_at: 0,
            unpacked_bytes: 0,
            max_unpacked_bytes: MIN_UNPACKED_BYTES.max(MAX_EXPANSION.saturating_mul(bytes.len() as u64)),
        }
    }

    /// Returns the next record; `None` at the end of the data. Use nothing after a [`Stop`].
    pub fn next(&mut self) -> Option<Result<Step<'_>, Stop>> {
        while self.within >= self.chunk.len() {
            let at = self.outer.at;
            self.chunk_at = at;
            let raw = match self.outer.next()? {
                Ok(raw) => raw,
                Err(what) => return Some(Err(Stop { what, at })),
            };
            match raw.opcode {
                op::DATA_END => {
                    self.outer.at = self.outer.bytes.len();
                    return None;
                }
                op::HEADER | op::METADATA | op::ATTACHMENT => {
                    return Some(Ok(match raw.parse() {
                        Ok(record) => Step::Record(record, at),
                        Err(what) => Step::Damaged { part: raw.part(), what, at },
                    }));
                }
                op::CHUNK => {
                    if let Err(what) = self.open(&raw) {
                        return Some(Err(Stop { what: format!("{what} (the chunk at byte {at})"), at }));
                    }
                }
                op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                    let step = raw.parse().map(|record| Step::Record(record, at));
                    return Some(step.map_err(|what| Stop { what, at }));
                }
                // No row depends on other records, or on a record whose kind is damaged: chunks are checked themselves.
                _ => {}
            }
        }
        let mut inner = Records { bytes: &self.chunk, at: self.within };
        let raw = inner.next()?;
        self.within = inner.at;
        let at = self.chunk_at;
        let stop = |what| Stop { what: format!("{what} (the chunk at byte {at})"), at };
        Some(raw.and_then(|raw| raw.parse()).map(|record| Step::Record(record, at)).map_err(stop))
    }

    fn open(&mut self, raw: &Raw<'a>) -> Result<(), String> {
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
        self.chunk = chunk.unpack()?;
        self.within = 0;
        Ok(())
    }
}

/// Result of the checks of a file as a whole.
#[derive(Default)]
pub(crate) struct Verified {
    /// Damage that the checks found, and its byte offset where it is known.
    pub problem: Option<(String, Option<usize>)>,
    /// Statistics of a file whose end is intact.
    pub statistics: Option<Statistics>,
    /// True if the file has its end records, whether they are intact or not.
    pub closed: bool,
}

/// Verifies that the file is complete and unchanged: it has an end, and the checksums of its data and summary sections
/// match.
pub(crate) fn verify(bytes: &[u8]) -> Verified {
    let mut verified = Verified::default();
    let mut summary = None;
    let mut records = Records { bytes, at: MAGIC.len() };
    while let Some(raw) = records.next() {
        let Ok(raw) = raw else { break };
        match (raw.opcode, raw.parse(), summary) {
            (op::DATA_END, Ok(Record::DataEnd { crc }), None) => {
                let problem = checksum("the data", crc, &bytes[..raw.at]).err();
                verified.problem = problem.map(|what| (what, None));
                summary = Some(records.at);
            }
            (op::STATISTICS, Ok(Record::Statistics(statistics)), Some(_)) => {
                verified.statistics = Some(statistics);
            }
            (op::FOOTER, Ok(Record::Footer { crc }), Some(from)) => {
                // The checksum covers the footer up to the checksum itself.
                let sum = checksum("the summary", crc, &bytes[from..records.at - size_of::<u32>()]);
                verified.closed = &bytes[records.at..] == MAGIC;
                if let Err(what) = sum {
                    verified.statistics = None;
                    verified.problem.get_or_insert((what, Some(from)));
                }
                break;
            }
            (op::DATA_END | op::FOOTER, ..) => break,
            _ => {}
        }
    }
    if !verified.closed {
        verified.statistics = None;
        verified.problem.get_or_insert_with(|| {
            ("the file is truncated: it has no end record".to_owned(), Some(bytes.len()))
        });
    }
    verified
}
