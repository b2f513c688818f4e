//! What can go wrong with a log.

use std::fmt;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// A log can't be written or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LogError {
    /// The sink failed (a full disk, for one): what was written before it is readable.
    #[error("can't write the log: {0}")]
    Write(#[source] io::Error),
    /// The file can't be read at all.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The file doesn't begin as an MCAP file does.
    #[error("this is not an MCAP file: it doesn't begin with the bytes 89 'MCAP0' 0D 0A")]
    NotMcap,
    /// An MCAP file, but nothing of opspace can be read from it.
    #[error("this MCAP file holds no channel recorded by opspace{}", because(damage.as_ref()))]
    NoChannel {
        /// What is broken, if anything is.
        damage: Option<Damage>,
    },
    /// A log that lacks what a replay needs.
    #[error("this log has no '{name}', which a replay needs")]
    NoSignal {
        /// The signal or channel.
        name: String,
    },
    /// Two channels to be recorded have one name.
    #[error("two channels are called '{name}'; each needs a name of its own")]
    DuplicateChannel {
        /// The name.
        name: String,
    },
    /// The header's model isn't the robot whose rows are recorded.
    #[error("q in the channel 'tick' has {elements} elements but the model '{model}' has {joints} joints")]
    ModelMismatch {
        /// The model's name.
        model: String,
        /// How many joints it has.
        joints: usize,
        /// How many elements q has in the layout.
        elements: usize,
    },
}

/// Where a log stops being readable. All that was read before is good.
#[derive(Clone, Debug, PartialEq)]
pub struct Damage {
    /// What is wrong.
    pub what: String,
    /// Time of the last good row, s; `None` if there is none.
    pub after_s: Option<f64>,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.after_s {
            Some(t) => write!(f, "{}; good up to t = {t} s", self.what),
            None => write!(f, "{}; no row is good", self.what),
        }
    }
}

fn because(damage: Option<&Damage>) -> String {
    damage.map_or_else(String::new, |d| format!(" ({})", d.what))
}

impl From<mcap::McapError> for LogError {
    /// Of a writer: the sink's own error where it is one.
    fn from(error: mcap::McapError) -> Self {
        Self::Write(match error {
            mcap::McapError::Io(e) => e,
            other => io::Error::other(other),
        })
    }
}
