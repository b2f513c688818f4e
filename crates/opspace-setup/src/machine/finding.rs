//! Findings about a machine.

use serde::Serialize;

/// Finding about a machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct MachineFinding {
    /// Item that was examined.
    pub item: &'static str,
    /// Verdict.
    pub level: Level,
    /// Observation, a sentence without a full stop.
    pub text: String,
    /// Commands for a shell that mend it; none if nothing is to be done.
    pub commands: Vec<String>,
}

/// Verdict on an item of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// As real-time control needs it.
    Ok,
    /// Information.
    Note,
    /// Real-time control lacks it.
    Missing,
}

impl Level {
    /// Name of the verdict.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Note => "note",
            Self::Missing => "missing",
        }
    }
}

impl MachineFinding {
    fn new(item: &'static str, level: Level, text: impl Into<String>) -> Self {
        Self { item, level, text: text.into(), commands: Vec::new() }
    }

    pub(super) fn ok(item: &'static str, text: impl Into<String>) -> Self {
        Self::new(item, Level::Ok, text)
    }

    pub(super) fn note(item: &'static str, text: impl Into<String>) -> Self {
        Self::new(item, Level::Note, text)
    }

    pub(super) fn missing(item: &'static str, text: impl Into<String>) -> Self {
        Self::new(item, Level::Missing, text)
    }

    pub(super) fn mended_by(mut self, command: impl Into<String>) -> Self {
        self.commands.push(command.into());
        self
    }
}
