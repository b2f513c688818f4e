//! Edits of an input: of its numbers, words, lines and bytes.

use bolero::{TypeGenerator, ValueGenerator, produce};

/// Largest number of edits of one input.
const MAX_EDITS: usize = 5;

/// Largest size of an edited input, bytes; further copies are left out.
const MAX_BYTES: usize = 256 << 10;

/// Texts that replace numbers and words.
const EDGES: [&str; 48] = [
    "0",
    "-0",
    "-0.0",
    "1",
    "-1",
    "2",
    "0.5",
    "1e-9",
    "5e-324",
    "1e-308",
    "1e-160",
    "1e9",
    "1e160",
    "1e308",
    "-1e308",
    "1.7976931348623157e308",
    "1e400",
    "nan",
    "inf",
    "-inf",
    "65536",
    "4294967296",
    "9007199254740993",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551615",
    "340282366920938463463374607431768211456",
    "",
    " ",
    "\"\"",
    "''",
    "\"",
    "true",
    "null",
    "[]",
    "{}",
    "[1, 2]",
    "a.b",
    "../..",
    "/dev/null",
    "é",
    "\u{202e}",
    "\u{0}",
    "\u{feff}",
    "<fuzz>",
    "&amp;",
    "=",
    "\r\n",
];

/// Edit of a text or of bytes. Positions count from 0, and begin again after the last.
#[derive(Clone, Debug, TypeGenerator)]
pub enum Edit {
    /// Replaces a number by an edge value.
    Number { at: u16, edge: u8 },
    /// Multiplies a number by a power of ten, and negates it.
    Scale {
        at: u16,
        #[generator(-20i8..20)]
        power: i8,
        negate: bool,
    },
    /// Replaces a word or a number by an edge value.
    Word { at: u16, edge: u8 },
    /// Replaces a word or a number by another one of the text.
    OtherWord { at: u16, from: u16 },
    /// Deletes lines.
    DeleteLines {
        at: u16,
        #[generator(1u8..4)]
        count: u8,
    },
    /// Copies lines to another place.
    CopyLines {
        at: u16,
        #[generator(1u8..8)]
        count: u8,
        to: u16,
        #[generator(1u8..40)]
        times: u8,
    },
    /// Exchanges two lines.
    SwapLines { one: u16, other: u16 },
    /// Copies lines of another seed into the text.
    Splice {
        seed: u8,
        at: u16,
        #[generator(1u8..20)]
        count: u8,
        to: u16,
    },
    /// Inserts an edge value, once or nested deeply.
    Insert {
        at: u16,
        edge: u8,
        #[generator(0u8..14)]
        doublings: u8,
    },
    /// Deletes what is between a quote, or a bracket, and the next closing one.
    Empty { at: u16 },
    /// Changes a byte.
    Byte { at: u32, change: u8 },
    /// Deletes bytes.
    Delete {
        at: u32,
        #[generator(1u8..16)]
        count: u8,
    },
    /// Deletes everything from a byte on.
    Cut { at: u32 },
}

/// Generator of the number of a seed below `seeds`, and of the edits of that seed.
pub fn edited(seeds: usize) -> impl ValueGenerator<Output = (usize, Vec<Edit>)> {
    (0..seeds, produce::<Vec<Edit>>().with().len(0..=MAX_EDITS))
}

/// Returns a seed after its edits.
pub fn apply<S: AsRef<[u8]>>(seeds: &[S], seed: usize, edits: &[Edit]) -> Vec<u8> {
    let mut bytes = seeds[seed].as_ref().to_vec();
    for edit in edits {
        bytes = edit.apply(&bytes, seeds);
    }
    bytes
}

/// Returns a seed after its edits as a text.
pub fn apply_to_text(seeds: &[String], seed: usize, edits: &[Edit]) -> String {
    String::from_utf8_lossy(&apply(seeds, seed, edits)).into_owned()
}

impl Edit {
    /// True if the edit changes, deletes or cuts bytes, without adding any.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Byte { .. } | Self::Delete { .. } | Self::Cut { .. })
    }

    /// Returns the edited bytes.
    pub fn apply<S: AsRef<[u8]>>(&self, bytes: &[u8], seeds: &[S]) -> Vec<u8> {
        let edge = |edge: u8| EDGES[usize::from(edge) % EDGES.len()].as_bytes();
        match *self {
            Self::Number { at, edge: value } => {
                let numbers = words(bytes, is_number);
                replaced(bytes, nth(&numbers, at), edge(value))
            }
            Self::Scale { at, power, negate } => {
                let numbers = words(bytes, is_number);
                let Some(range) = nth(&numbers, at) else { return bytes.to_vec() };
                let number = number(&bytes[range.0..range.1]).unwrap_or(0.0);
                let sign = if negate { -1.0 } else { 1.0 };
                let scaled = format!("{:?}", sign * number * 10_f64.powi(power.into()));
                replaced(bytes, Some(range), scaled.as_bytes())
            }
            Self::Word { at, edge: value } => {
                let words = words(bytes, |_| true);
                replaced(bytes, nth(&words, at), edge(value))
            }
            Self::OtherWord { at, from } => {
                let words = words(bytes, |_| true);
                let other = nth(&words, from).map(|(begin, end)| bytes[begin..end].to_vec());
                replaced(bytes, nth(&words, at), &other.unwrap_or_default())
            }
            Self::DeleteLines { at, count } => {
                let mut lines = lines(bytes);
                let begin = index(at.into(), lines.len());
                lines.drain(begin..(begin + usize::from(count)).min(lines.len()));
                lines.concat()
            }
            Self::CopyLines { at, count, to, times } => {
                let lines = lines(bytes);
                let begin = index(at.into(), lines.len());
                let copied = lines[begin..(begin + usize::from(count)).min(lines.len())].concat();
                inserted_lines(&lines, to, &copied.repeat(times.into()))
            }
            Self::SwapLines { one, other } => {
                let mut lines = lines(bytes);
                let (one, other) = (index(one.into(), lines.len()), index(other.into(), lines.len()));
                if !lines.is_empty() {
                    lines.swap(one, other);
                }
                lines.concat()
            }
            Self::Splice { seed, at, count, to } => {
                let other = lines(seeds[index(seed.into(), seeds.len())].as_ref());
                let begin = index(at.into(), other.len());
                let copied = other[begin..(begin + usize::from(count)).min(other.len())].concat();
                inserted_lines(&lines(bytes), to, &copied)
            }
            Self::Insert { at, edge: value, doublings } => {
                // Between words, where it may have a meaning.
                let words = words(bytes, |_| true);
                let at = nth(&words, at).map_or(0, |(begin, _)| begin);
                const NESTS: [&str; 6] = ["[", "{", "(", "<a>", "a.", "\"a\":["];
                let text = match usize::from(value) {
                    value if doublings > 7 => NESTS[value % NESTS.len()].repeat(1 << doublings),
                    _ => String::from_utf8_lossy(edge(value)).into_owned(),
                };
                replaced(bytes, Some((at, at)), text.as_bytes())
            }
            Self::Empty { at } => {
                let closing = |byte: u8| match byte {
                    b'[' => Some(b']'),
                    b'{' => Some(b'}'),
                    b'<' => Some(b'>'),
                    b'"' | b'\'' => Some(byte),
                    _ => None,
                };
                let opens: Vec<usize> = (0..bytes.len()).filter(|&k| closing(bytes[k]).is_some()).collect();
                let Some(&open) = opens.get(index(at.into(), opens.len())) else { return bytes.to_vec() };
                let rest = &bytes[open + 1..];
                let length = rest.iter().position(|&byte| closing(bytes[open]) == Some(byte)).unwrap_or(0);
                replaced(bytes, Some((open + 1, open + 1 + length)), b"")
            }
            Self::Byte { at, change } => {
                let mut bytes = bytes.to_vec();
                let at = index(at as usize, bytes.len());
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= change;
                }
                bytes
            }
            Self::Delete { at, count } => {
                let begin = index(at as usize, bytes.len());
                let end = (begin + usize::from(count)).min(bytes.len());
                [&bytes[..begin], &bytes[end..]].concat()
            }
            Self::Cut { at } => bytes[..index(at as usize, bytes.len())].to_vec(),
        }
    }
}

/// Position within a list of `length`; 0 for an empty one.
pub fn index(at: usize, length: usize) -> usize {
    at.checked_rem(length).unwrap_or(0)
}

fn nth(ranges: &[(usize, usize)], at: u16) -> Option<(usize, usize)> {
    ranges.get(index(at.into(), ranges.len())).copied()
}

/// Ranges of the words of letters, digits and signs of numbers for which `is_wanted` is true.
fn words(bytes: &[u8], is_wanted: fn(&[u8]) -> bool) -> Vec<(usize, usize)> {
    let in_word = |byte: &u8| byte.is_ascii_alphanumeric() || b"_.+-".contains(byte);
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let length = bytes[at..].iter().take_while(|byte| in_word(byte)).count();
        if length > 0 && is_wanted(&bytes[at..at + length]) {
            found.push((at, at + length));
        }
        at += length.max(1);
    }
    found
}

fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

fn is_number(word: &[u8]) -> bool {
    word.iter().any(u8::is_ascii_digit) && number(word).is_some()
}

fn lines(bytes: &[u8]) -> Vec<&[u8]> {
    bytes.split_inclusive(|&byte| byte == b'\n').collect()
}

fn inserted_lines(lines: &[&[u8]], to: u16, more: &[u8]) -> Vec<u8> {
    let to = index(to.into(), lines.len() + 1);
    let size = lines.iter().map(|line| line.len()).sum::<usize>() + more.len();
    let more = if size > MAX_BYTES { &[][..] } else { more };
    [&lines[..to].concat(), more, &lines[to..].concat()].concat()
}

fn replaced(bytes: &[u8], range: Option<(usize, usize)>, by: &[u8]) -> Vec<u8> {
    let (begin, end) = range.unwrap_or((0, 0));
    [&bytes[..begin], by, &bytes[end..]].concat()
}
