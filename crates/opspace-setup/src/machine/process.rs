//! Rights of this process: limits, capabilities, user and groups.

use super::root::Root;
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;

/// Bits of capabilities in `/proc/self/status`.
pub(super) const CAP_DAC_OVERRIDE: u32 = 1;
pub(super) const CAP_IPC_LOCK: u32 = 14;
pub(super) const CAP_SYS_NICE: u32 = 23;

/// Limit of a resource.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Limit {
    Unlimited,
    Value(u64),
}

/// Rights of this process.
pub(super) struct Process {
    /// Highest real-time priority; `None` if it is not known.
    pub(super) priority: Option<Limit>,
    /// Locked memory, bytes; `None` if it is not known.
    pub(super) locked_memory: Option<Limit>,
    capabilities: u64,
    user: Option<u32>,
    groups: Vec<u32>,
}

impl Process {
    pub(super) fn read(root: &Root<'_>) -> Self {
        let limits = root.text("proc/self/limits").unwrap_or_default();
        let status = root.text("proc/self/status").unwrap_or_default();
        let line = |name: &str| status.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default();
        let ids = |name: &str| -> Vec<u32> {
            line(name).split_whitespace().filter_map(|word| word.parse().ok()).collect()
        };
        // Effective identifiers are the second ones.
        let group = ids("Gid:").get(1).copied();
        Self {
            priority: limit(&limits, "Max realtime priority"),
            locked_memory: limit(&limits, "Max locked memory"),
            capabilities: u64::from_str_radix(line("CapEff:").trim(), 16).unwrap_or(0),
            user: ids("Uid:").get(1).copied(),
            groups: ids("Groups:").into_iter().chain(group).collect(),
        }
    }

    pub(super) fn has_capability(&self, bit: u32) -> bool {
        self.capabilities >> bit & 1 == 1
    }

    pub(super) fn is_in_group(&self, group: u32) -> bool {
        self.groups.contains(&group)
    }

    /// True if the process may read and write a file.
    pub(super) fn may_use(&self, file: &Metadata) -> bool {
        const READ_AND_WRITE: u32 = 0o6;
        let shift = match () {
            () if self.has_capability(CAP_DAC_OVERRIDE) => return true,
            () if self.user == Some(file.uid()) => 6,
            () if self.is_in_group(file.gid()) => 3,
            () => 0,
        };
        file.mode() >> shift & READ_AND_WRITE == READ_AND_WRITE
    }
}

/// Soft limit in `/proc/self/limits`.
fn limit(limits: &str, name: &str) -> Option<Limit> {
    let line = limits.lines().find_map(|line| line.strip_prefix(name))?;
    match line.split_whitespace().next()? {
        "unlimited" => Some(Limit::Unlimited),
        number => number.parse().ok().map(Limit::Value),
    }
}
