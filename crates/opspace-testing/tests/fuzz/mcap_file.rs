//! Records of an MCAP file, from which edits make another file with valid lengths and checksums.

use crate::edits::{Edit, index};
use bolero::TypeGenerator;
use mcap::MAGIC;
use mcap::records::op;

/// Edit of the records of a file, including those in its chunks. Positions count from 0, and begin again after the
/// last.
#[derive(Clone, Debug, TypeGenerator)]
pub enum RecordEdit {
    /// Edits the content of a record.
    Content { record: u16, edit: Edit },
    /// Edits a text in a record, with the lengths that belong to it: a name, the layout of a channel, an attached file.
    Text { record: u16, text: u8, edit: Edit },
    /// Changes the kind of a record.
    Kind {
        record: u16,
        #[generator(0u8..18)]
        kind: u8,
    },
    /// Deletes records.
    Delete {
        record: u16,
        #[generator(1u8..4)]
        count: u8,
    },
    /// Copies a record to another place.
    Copy { record: u16, to: u16 },
    /// Exchanges two records.
    Swap { one: u16, other: u16 },
}

/// Record of a file.
#[derive(Clone)]
struct Record {
    kind: u8,
    content: Vec<u8>,
    /// Number of the chunk in which it is; `None` outside of chunks.
    chunk: Option<usize>,
}

/// Records of an intact file, in order.
#[derive(Clone)]
pub struct Records(Vec<Record>);

impl Records {
    /// Reads the records of an intact file.
    ///
    /// # Panics
    /// If the file is not intact.
    pub fn of(bytes: &[u8]) -> Self {
        let mut records = Vec::new();
        let mut chunks = 0;
        for (kind, content) in split(&bytes[MAGIC.len()..bytes.len() - MAGIC.len()]) {
            if kind != op::CHUNK {
                records.push(Record { kind, content: content.to_vec(), chunk: None });
                continue;
            }
            // Two times, the size, the checksum, the name of the compression, the size of the rest.
            let size = u64_at(content, 16);
            let name_end = 32 + u32::from_le_bytes(content[28..32].try_into().expect("four bytes")) as usize;
            let packed = &content[name_end + 8..];
            let inner = match &content[32..name_end] {
                b"zstd" => zstd::bulk::decompress(packed, size as usize).expect("an intact chunk"),
                _ => packed.to_vec(),
            };
            let chunk = Some(chunks);
            records.extend(split(&inner).map(|(kind, content)| Record {
                kind,
                content: content.to_vec(),
                chunk,
            }));
            chunks += 1;
        }
        Self(records)
    }

    /// Applies an edit; `seeds` are the records of all seeds, whose contents a splice takes.
    pub fn edit(&mut self, edit: &RecordEdit, seeds: &[Self]) {
        let all = &mut self.0;
        if all.is_empty() {
            return;
        }
        let count = all.len();
        match edit {
            RecordEdit::Content { record, edit } => all[index((*record).into(), count)].edit(edit, seeds),
            RecordEdit::Text { record, text, edit } => {
                let mut defined: Vec<&mut Record> =
                    all.iter_mut().filter(|record| fields(record.kind).is_some()).collect();
                let place = index((*record).into(), defined.len());
                if let Some(record) = defined.get_mut(place) {
                    record.edit_text(*text, edit);
                }
            }
            RecordEdit::Kind { record, kind } => all[index((*record).into(), count)].kind = *kind,
            RecordEdit::Delete { record, count: more } => {
                let begin = index((*record).into(), count);
                all.drain(begin..(begin + usize::from(*more)).min(count));
            }
            RecordEdit::Copy { record, to } => {
                let copied = all[index((*record).into(), count)].clone();
                all.insert(index((*to).into(), count), copied);
            }
            RecordEdit::Swap { one, other } => {
                all.swap(index((*one).into(), count), index((*other).into(), count))
            }
        }
    }

    /// Returns the file of these records, with lengths, checksums of chunks, attachments, data and summary that fit.
    pub fn file(&self) -> Vec<u8> {
        let mut file = MAGIC.to_vec();
        let mut at = 0;
        let mut summary = None;
        while let Some(record) = self.0.get(at) {
            let length = self.0[at..].iter().take_while(|other| other.chunk == record.chunk).count();
            if record.chunk.is_some() {
                let mut inner = Vec::new();
                self.0[at..at + length].iter().for_each(|record| record.write(&mut inner));
                chunk(&inner).write(&mut file);
                at += length;
                continue;
            }
            let mut record = record.clone();
            match (record.kind, record.content.len()) {
                (op::ATTACHMENT, 4..) => {
                    let checked = record.content.len() - 4;
                    let crc = crc32fast::hash(&record.content[..checked]);
                    record.content[checked..].copy_from_slice(&crc.to_le_bytes());
                }
                (op::DATA_END, 4) => record.content = crc32fast::hash(&file).to_le_bytes().to_vec(),
                _ => {}
            }
            record.write(&mut file);
            match (record.kind, summary) {
                (op::DATA_END, _) => summary = Some(file.len()),
                (op::FOOTER, Some(from)) if record.content.len() == 20 => {
                    let checked = file.len() - 4;
                    let crc = crc32fast::hash(&file[from..checked]);
                    file[checked..].copy_from_slice(&crc.to_le_bytes());
                }
                _ => {}
            }
            at += 1;
        }
        file.extend(MAGIC);
        file
    }
}

impl Record {
    fn edit(&mut self, edit: &Edit, seeds: &[Records]) {
        let same: Vec<&[u8]> =
            seeds.iter().flat_map(|seed| &seed.0).map(|other| other.content.as_slice()).collect();
        self.content = edit.apply(&self.content, &same);
    }

    /// Edits one of the texts of the record; its lines may also be those of the other texts.
    fn edit_text(&mut self, text: u8, edit: &Edit) {
        let Some(mut read) = fields(self.kind).and_then(|kinds| read(kinds, &self.content)) else { return };
        let texts: Vec<Vec<u8>> = read.iter().flat_map(|(_, texts)| texts.iter().cloned()).collect();
        let mut places: Vec<&mut Vec<u8>> = read
            .iter_mut()
            .filter(|(kind, _)| !matches!(kind, Field::Bytes(_)))
            .flat_map(|(_, texts)| texts.iter_mut())
            .collect();
        let place = index(text.into(), places.len());
        if let Some(chosen) = places.get_mut(place) {
            **chosen = edit.apply(chosen, &texts);
            self.content = written(&read);
        }
    }

    fn write(&self, to: &mut Vec<u8>) {
        to.push(self.kind);
        to.extend((self.content.len() as u64).to_le_bytes());
        to.extend(&self.content);
    }
}

/// Field of a record.
#[derive(Clone, Copy)]
enum Field {
    /// So many bytes.
    Bytes(usize),
    /// Text after its length of four bytes.
    Text,
    /// Text after its length of eight bytes.
    LongText,
    /// Texts in pairs, after the length of all.
    Map,
}

/// Returns the fields of a record with texts.
fn fields(kind: u8) -> Option<&'static [Field]> {
    use Field::{Bytes, LongText, Map, Text};
    match kind {
        op::HEADER => Some(&[Text, Text]),
        op::SCHEMA => Some(&[Bytes(2), Text, Text, Text]),
        op::CHANNEL => Some(&[Bytes(4), Text, Text, Map]),
        op::ATTACHMENT => Some(&[Bytes(16), Text, Text, LongText, Bytes(4)]),
        op::METADATA => Some(&[Text, Map]),
        _ => None,
    }
}

/// Reads the fields of a record: their kinds and texts. `None` if the record is not made of them.
fn read(kinds: &[Field], mut content: &[u8]) -> Option<Vec<(Field, Vec<Vec<u8>>)>> {
    let mut take = |length: usize| {
        let (taken, rest) = content.split_at_checked(length)?;
        content = rest;
        Some(taken.to_vec())
    };
    let mut fields = Vec::new();
    for &kind in kinds {
        let texts = match kind {
            Field::Bytes(length) => vec![take(length)?],
            Field::Text => {
                let length = u32_at(&take(4)?);
                vec![take(length)?]
            }
            Field::LongText => {
                let length = usize::try_from(u64_at(&take(8)?, 0)).ok()?;
                vec![take(length)?]
            }
            Field::Map => {
                let length = u32_at(&take(4)?);
                let mut pairs = take(length)?;
                let mut texts = Vec::new();
                while pairs.len() >= 4 {
                    let end = 4_usize.checked_add(u32_at(&pairs))?;
                    texts.push(pairs.get(4..end)?.to_vec());
                    pairs.drain(..end);
                }
                texts
            }
        };
        fields.push((kind, texts));
    }
    Some(fields)
}

/// Returns the content of a record with these fields.
fn written(fields: &[(Field, Vec<Vec<u8>>)]) -> Vec<u8> {
    let mut content = Vec::new();
    let put = |to: &mut Vec<u8>, text: &[u8]| {
        to.extend((text.len() as u32).to_le_bytes());
        to.extend(text);
    };
    for (kind, texts) in fields {
        match kind {
            Field::Bytes(_) => content.extend(texts.concat()),
            Field::Text => put(&mut content, &texts.concat()),
            Field::LongText => {
                let text = texts.concat();
                content.extend((text.len() as u64).to_le_bytes());
                content.extend(text);
            }
            Field::Map => {
                let mut pairs = Vec::new();
                texts.iter().for_each(|text| put(&mut pairs, text));
                put(&mut content, &pairs);
            }
        }
    }
    content
}

/// Chunk of these records, compressed.
fn chunk(inner: &[u8]) -> Record {
    let packed = zstd::bulk::compress(inner, 1).expect("compressed");
    let mut content = vec![0; 16];
    content.extend((inner.len() as u64).to_le_bytes());
    content.extend(crc32fast::hash(inner).to_le_bytes());
    content.extend(4_u32.to_le_bytes());
    content.extend(b"zstd");
    content.extend((packed.len() as u64).to_le_bytes());
    content.extend(packed);
    Record { kind: op::CHUNK, content, chunk: None }
}

/// Kinds and contents of the records in these bytes.
fn split(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (&kind, rest) = bytes.split_first()?;
        let (content, rest) = rest[8..].split_at(u64_at(rest, 0) as usize);
        bytes = rest;
        Some((kind, content))
    })
}

fn u32_at(bytes: &[u8]) -> usize {
    u32::from_le_bytes(bytes[..4].try_into().expect("four bytes")) as usize
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight bytes"))
}
