//! Examination of a machine: the items that real-time control lacks, each with the commands that mend it.
//!
//! [`examine`] reads the files of a Linux system below a root, which is `/` or, in tests, a made-up tree. [`wake_up`] measures.

mod finding;
mod kernel;
mod limits;
mod ports;
mod process;
mod processors;
mod root;
pub mod wake_up;

pub use finding::{Level, MachineFinding};
use process::Process;
use root::Root;
use std::path::Path;

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
