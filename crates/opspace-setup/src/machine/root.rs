//! Files below a root.

use opspace_model::files::read_file;
use std::fs::{self, Metadata};
use std::path::{Path, PathBuf};

/// Largest file that is read, bytes.
const LIMIT: u64 = 1 << 20;

/// Most entries of a folder that are listed.
const MOST_ENTRIES: usize = 4096;

/// Root of a file system.
pub(super) struct Root<'a>(&'a Path);

impl<'a> Root<'a> {
    pub(super) fn new(path: &'a Path) -> Self {
        Self(path)
    }

    fn at(&self, path: &str) -> PathBuf {
        self.0.join(path)
    }

    /// Text of a file without spaces around it; `None` if it cannot be read, and without bytes that are no text.
    pub(super) fn text(&self, path: &str) -> Option<String> {
        let bytes = read_file(&self.at(path), LIMIT).ok()?;
        Some(String::from_utf8_lossy(&bytes).trim().to_owned())
    }

    /// Number in a file.
    pub(super) fn number(&self, path: &str) -> Option<i64> {
        self.text(path)?.parse().ok()
    }

    pub(super) fn exists(&self, path: &str) -> bool {
        self.at(path).exists()
    }

    /// Owner and permissions of a file.
    pub(super) fn metadata(&self, path: &str) -> Option<Metadata> {
        fs::metadata(self.at(path)).ok()
    }

    /// Sorted names in a folder that begin like this; none if it cannot be read. Names that a shell would not take literally are
    /// left out.
    pub(super) fn names(&self, folder: &str, beginning: &str) -> Vec<String> {
        let entries = fs::read_dir(self.at(folder)).into_iter().flatten().flatten().take(MOST_ENTRIES);
        let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut names: Vec<String> =
            names.filter(|name| name.starts_with(beginning) && is_plain(name)).collect();
        names.sort_by_key(|name| (name.len(), name.clone()));
        names
    }

    /// Folders of the processors: `sys/devices/system/cpu/cpu0`.
    pub(super) fn processors(&self) -> Vec<String> {
        const FOLDER: &str = "sys/devices/system/cpu";
        let is_number = |name: &String| name[3..].parse::<u32>().is_ok();
        let names = self.names(FOLDER, "cpu").into_iter().filter(is_number);
        names.map(|name| format!("{FOLDER}/{name}")).collect()
    }

    /// True inside a container.
    pub(super) fn is_container(&self) -> bool {
        self.exists(".dockerenv") || self.exists("run/.containerenv")
    }

    /// Names of the distribution and of those that it is like.
    pub(super) fn distributions(&self) -> Vec<String> {
        let text = self.text("etc/os-release").unwrap_or_default();
        let lines =
            text.lines().filter_map(|line| line.strip_prefix("ID=").or(line.strip_prefix("ID_LIKE=")));
        lines.flat_map(|names| names.trim_matches('"').split_whitespace().map(str::to_owned)).collect()
    }
}

/// True for a name that a shell takes literally.
pub(super) fn is_plain(name: &str) -> bool {
    name.chars().all(|c| c.is_ascii_alphanumeric() || ['_', '-', '.'].contains(&c))
}
