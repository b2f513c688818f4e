//! Values that are compared of a run or of a checked file, as lines of text.

use std::fmt::Write;

/// Kind of a compared value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Signal of a log, `tick/hand.force`; the value is a hash.
    Signal,
    /// Key of a JSON file, `metrics.position_rms_m`, or another fact; the value is its JSON.
    Key,
    /// Output of the program, `stdout`; the value is one of its lines.
    Line,
}

/// Kinds, with the words by which files name them.
const KINDS: [(&str, Kind); 3] = [("signal", Kind::Signal), ("key", Kind::Key), ("line", Kind::Line)];

/// Name of an entry that states why something was not compared.
pub const NOT_COMPARED: &str = "(not compared)";

/// Compared value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Kind.
    pub kind: Kind,
    /// Name.
    pub name: String,
    /// Value, one line.
    pub value: String,
}

/// Run or checked file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Item {
    /// Place in the part, by which the items of two builds are paired; it has no blanks.
    pub place: String,
    /// Description of the place for the reader.
    pub spelling: String,
    /// Values.
    pub entries: Vec<Entry>,
}

impl Kind {
    /// Word by which files name the kind.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.iter().find(|(_, kind)| *kind == self).map_or("", |(name, _)| name)
    }

    /// Reads the word of a kind.
    #[must_use]
    pub fn named(word: &str) -> Option<Self> {
        KINDS.iter().find(|(name, _)| *name == word).map(|(_, kind)| *kind)
    }
}

impl Entry {
    /// Creates an entry; blanks of the value become single spaces, except for leading spaces.
    #[must_use]
    pub fn new(kind: Kind, name: &str, value: &str) -> Self {
        Self {
            kind,
            name: name.to_owned(),
            value: value.replace(['\t', '\n', '\r'], " ").trim_end().to_owned(),
        }
    }
}

/// Formats items, a line for each entry.
#[must_use]
pub fn text(items: &[Item]) -> String {
    let mut text = String::new();
    for item in items {
        for Entry { kind, name, value } in &item.entries {
            let _ = writeln!(text, "{} {}\t{}\t{name}\t{value}", item.place, item.spelling, kind.name());
        }
    }
    text
}

/// Reads the line of an entry: its place, and the entry.
///
/// # Errors
/// A line that is none of an entry.
pub fn read(line: &str) -> Result<(&str, Entry), String> {
    let fields: Vec<&str> = line.split('\t').collect();
    let [item, kind, name, value] = fields[..] else { return Err(format!("'{line}' is no line of results")) };
    let kind = Kind::named(kind).ok_or_else(|| format!("'{kind}' is no kind of result"))?;
    Ok((item.split(' ').next().unwrap_or_default(), Entry::new(kind, name, value)))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::{Entry, Item, Kind, read, text};

    /// Compared: entries, and those that are read from their text.
    #[test]
    fn entries_are_read_as_they_were_written() {
        let entries = vec![
            Entry::new(Kind::Signal, "tick/q", "9x2 aa"),
            Entry::new(Kind::Key, "faulted", "\"a\tb\""),
            Entry::new(Kind::Line, "stdout", "  an indented line\n"),
            Entry::new(Kind::Line, "stdout", ""),
        ];
        let text = text(&[Item {
            place: "1.1".to_owned(),
            spelling: "of two words".to_owned(),
            entries: entries.clone(),
        }]);
        let read: Vec<_> = text.lines().map(|line| read(line).unwrap()).collect();
        assert!(read.iter().all(|(place, _)| *place == "1.1"));
        assert_eq!(read.into_iter().map(|(_, entry)| entry).collect::<Vec<_>>(), entries);
        assert_eq!(entries[2].value, "  an indented line");
        for wrong in ["", "a\tb\tc", "a\tsort\tb\tc", "a\tkey\tb\tc\td"] {
            assert!(super::read(wrong).is_err(), "{wrong}");
        }
    }
}
