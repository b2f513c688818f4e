//! Errors when writing and reading logs.

use std::fmt;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Reason why a log can't be written or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LogError {
    /// Failure of the sink, for example a full disk. Data written before the failure are readable.
    #[error("can't write the log: {0}")]
    Write(#[source] io::Error),
    /// File that can't be read.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Cause of the failure.
        source: io::Error,
    },
    /// File that doesn't begin with the magic bytes of MCAP.
    #[error("this is not an MCAP file: it doesn't begin with the bytes 89 'MCAP0' 0D 0A")]
    NotMcap,
    /// MCAP file without a readable channel of opspace.
    #[error("this MCAP file has no channel recorded by opspace{}", because(damage.as_ref()))]
    NoChannel {
        /// Damage of the file, if any.
        damage: Option<Corruption>,
    },
    /// Log that lacks a signal or channel that a replay needs.
    #[error("this log has no '{name}', which a replay needs")]
    NoSignal {
        /// Name of the signal or channel.
        name: String,
    },
    /// Two channels with the same name.
    #[error("two channels have the name '{name}'; names must be unique")]
    DuplicateChannel {
        /// Name of the channels.
        name: String,
    },
    /// Model in the header that doesn't fit the recorded rows.
    #[error("q in the channel 'tick' has {elements} elements but the model '{model}' has {joints} joints")]
    ModelMismatch {
        /// Name of the model.
        model: String,
        /// Number of joints of the model.
        joints: usize,
        /// Number of elements of q in the layout.
        elements: usize,
    },
}

/// Damage in a log. Everything that was read is intact.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Corruption {
    /// Description of the damage.
    pub what: String,
    /// Time of the last intact row, s; `None` if there is none.
    pub after_s: Option<f64>,
    /// False if all rows were read, as the end of the file confirms; true if some are missing or may be.
    pub rows_lost: bool,
    /// Byte offset in the file at which the damage begins, if it is known.
    pub at_byte: Option<usize>,
}

impl fmt::Display for Corruption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.after_s {
            Some(_) if !self.rows_lost => write!(f, "{}; all rows are readable", self.what),
            Some(t) => write!(f, "{}; readable up to t = {t} s", self.what),
            None => write!(f, "{}; no row is readable", self.what),
        }
    }
}

fn because(damage: Option<&Corruption>) -> String {
    damage.map_or_else(String::new, |d| format!(" ({})", d.what))
}

impl From<mcap::McapError> for LogError {
    /// Converts a writer's error, to the sink's own error if it has one.
    fn from(error: mcap::McapError) -> Self {
        Self::Write(match error {
            mcap::McapError::Io(e) => e,
            other => io::Error::other(other),
        })
    }
}
