//! Walk through the records of a file, also of those in chunks, with one unpacked chunk in memory at a time.

use crate::bytes::{Bytes, OuterRecords};
use crate::records::{Raw, Record, Records, Statistics, compare_checksums};
use crc32fast::Hasher;
use mcap::MAGIC;
use mcap::records::op;

/// Largest ratio of the size of all chunks, unpacked, to that in the file: a log of a simulation without noise has
/// some 10.
const MAX_EXPANSION: u64 = 100;

/// Size of all chunks, unpacked, that is accepted of any file, bytes.
const MIN_UNPACKED_BYTES: u64 = 16 << 20;

/// Records of a file up to its end record, in order.
pub(crate) struct Walk<'a> {
    outer: OuterRecords<'a>,
    ended: bool,
    /// Unpacked chunk.
    chunk: Vec<u8>,
    within: usize,
    chunk_at: usize,
    /// Size of all chunks so far, unpacked.
    unpacked_bytes: u64,
    /// Size of all chunks and messages so far, as they are in the file. The size of the file itself proves nothing: a
    /// hole in it takes no place on the disk.
    packed_bytes: u64,
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
    /// Returns a walk through a log, which begins with the magic bytes.
    pub fn new(source: &'a dyn Bytes) -> Self {
        Self {
            outer: OuterRecords::new(source, MAGIC.len() as u64),
            ended: false,
            chunk: Vec::new(),
            within: 0,
            chunk_at: 0,
            unpacked_bytes: 0,
            packed_bytes: 0,
        }
    }

    /// Size of all chunks and messages so far, as they are in the file, bytes.
    pub fn packed_bytes(&self) -> u64 {
        self.packed_bytes
    }

    /// Returns the next record; `None` at the end of the data. Use nothing after a [`Stop`].
    pub fn next(&mut self) -> Option<Result<Step<'_>, Stop>> {
        while self.within >= self.chunk.len() {
            if self.ended {
                return None;
            }
            let at = self.outer.at() as usize;
            self.chunk_at = at;
            match self.outer.advance()? {
                Ok(()) => {}
                Err(what) => return Some(Err(Stop { what, at })),
            }
            let Raw { opcode, body, .. } = self.outer.record();
            if matches!(opcode, op::CHUNK | op::MESSAGE) {
                self.packed_bytes += body.len() as u64;
            }
            match opcode {
                op::DATA_END => {
                    self.ended = true;
                    return None;
                }
                op::CHUNK => {
                    if let Err(what) = self.open() {
                        return Some(Err(Stop { what: format!("{what} (the chunk at byte {at})"), at }));
                    }
                }
                op::HEADER | op::METADATA | op::ATTACHMENT | op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                    return Some(outermost(self.outer.record()));
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

    /// Unpacks the chunk that is the present record of the file.
    fn open(&mut self) -> Result<(), String> {
        let Record::Chunk(chunk) = self.outer.record().parse()? else {
            return Ok(());
        };
        self.unpacked_bytes = self.unpacked_bytes.saturating_add(chunk.size());
        let most = MIN_UNPACKED_BYTES.max(MAX_EXPANSION.saturating_mul(self.packed_bytes));
        if self.unpacked_bytes > most {
            return Err(format!(
                "the chunks expand to more than {most} bytes, which no log of this size does"
            ));
        }
        self.chunk = chunk.unpack()?;
        self.within = 0;
        Ok(())
    }
}

/// Parses a record that is in no chunk.
fn outermost(raw: Raw<'_>) -> Result<Step<'_>, Stop> {
    let at = raw.at;
    match (raw.parse(), raw.opcode) {
        (Ok(record), _) => Ok(Step::Record(record, at)),
        (Err(what), op::SCHEMA | op::CHANNEL | op::MESSAGE) => Err(Stop { what, at }),
        (Err(what), _) => Ok(Step::Damaged { part: raw.part(), what, at }),
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
pub(crate) fn verify(source: &dyn Bytes) -> Verified {
    let mut verified = Verified::default();
    let mut summary_at = None;
    let mut records = OuterRecords::new(source, MAGIC.len() as u64);
    let mut hasher = Hasher::new();
    hasher.update(MAGIC);
    while let Some(Ok(())) = records.advance() {
        let raw = records.record();
        if let Err(what) = raw.refuse_length() {
            // Without its bytes no checksum can be verified.
            verified.problem.get_or_insert((what, Some(raw.at)));
        }
        match (raw.opcode, raw.parse(), summary_at) {
            (op::DATA_END, Ok(Record::DataEnd { crc }), None) => {
                if let Err(what) = compare_checksums("the data", crc, hasher.finalize()) {
                    verified.problem.get_or_insert((what, None));
                }
                summary_at = Some(records.at() as usize);
                hasher = Hasher::new();
                continue;
            }
            (op::STATISTICS, Ok(Record::Statistics(statistics)), Some(_)) => {
                verified.statistics = Some(statistics);
            }
            (op::FOOTER, Ok(Record::Footer { crc }), Some(from)) => {
                // The checksum covers the footer up to the checksum itself.
                let [prefix, body] = records.bytes();
                hasher.update(prefix);
                hasher.update(
                    body.split_last_chunk::<{ size_of::<u32>() }>().map_or(&[], |(before, _)| before),
                );
                let problem = compare_checksums("the summary", crc, hasher.finalize()).err();
                let mut end = [0; MAGIC.len()];
                verified.closed = source.len() == records.at() + MAGIC.len() as u64
                    && source.read_at(records.at(), &mut end).is_ok()
                    && end == MAGIC;
                if let Some(what) = problem {
                    verified.statistics = None;
                    verified.problem.get_or_insert((what, Some(from)));
                }
                break;
            }
            (op::DATA_END | op::FOOTER, ..) => break,
            _ => {}
        }
        records.bytes().iter().for_each(|part| hasher.update(part));
    }
    if !verified.closed {
        verified.statistics = None;
        verified.problem.get_or_insert_with(|| {
            let len = usize::try_from(source.len()).ok();
            ("the file is truncated: it has no end record".to_owned(), len)
        });
    }
    verified
}
