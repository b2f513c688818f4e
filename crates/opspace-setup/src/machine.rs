//! What a machine lacks for real-time control, each with the commands that mend it.
//!
//! [`examine`] reads the files of a Linux system below a root, which is `/` or, in tests, a made-up tree. [`wake_up`] measures.

mod kernel;
mod limits;
mod ports;
mod process;
mod processors;
mod root;
pub mod wake_up;

use process::Process;
use root::Root;
use serde::Serialize;
use std::path::Path;

/// Finding about a machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct MachineFinding {
    /// Item that was examined.
    pub item: &'static str,
    /// Verdict.
    pub level: Level,
    /// What was found, a sentence without a full stop.
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

    fn ok(item: &'static str, text: impl Into<String>) -> Self {
        Self::new(item, Level::Ok, text)
    }

    fn note(item: &'static str, text: impl Into<String>) -> Self {
        Self::new(item, Level::Note, text)
    }

    fn missing(item: &'static str, text: impl Into<String>) -> Self {
        Self::new(item, Level::Missing, text)
    }

    fn mended_by(mut self, command: impl Into<String>) -> Self {
        self.commands.push(command.into());
        self
    }
}

/// Examines the machine whose file system begins at `root`. A file that is missing or has unexpected contents is a note.
#[must_use]
pub fn examine(root: &Path) -> Vec<MachineFinding> {
    let root = Root::new(root);
    let process = Process::read(&root);
    let mut found = vec![
        limits::priority_limit(&root, &process),
        limits::memory_limit(&root, &process),
        limits::throttling(&root),
        kernel::kernel(&root),
        kernel::clock_source(&root),
        processors::governor(&root),
        processors::idle_states(&root, &process),
        processors::isolated(&root),
        kernel::swap(&root),
        kernel::machine(&root),
    ];
    found.extend(ports::serial_ports(&root, &process));
    found.extend(ports::latency_timers(&root));
    found
}

/// True if an item is missing.
#[must_use]
pub fn is_lacking(findings: &[MachineFinding]) -> bool {
    findings.iter().any(|finding| finding.level == Level::Missing)
}
