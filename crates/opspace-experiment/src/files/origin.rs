//! Sources of files: the disk, or the examples embedded in the binary.

use crate::files::source::{FileError, KeyPath, Source};
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

/// A source of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Files {
    /// The disk, relative to the working directory.
    Disk,
    /// The paper's robot, tasks and suite, embedded in the binary under their paths in the project.
    Embedded,
}

macro_rules! embedded {
    ($($path:literal),* $(,)?) => {
        &[$(($path, include_str!(concat!("../../embedded/", $path)))),*]
    };
}

/// Paths and contents of the files in `embedded/` of this crate.
const EMBEDDED: &[(&str, &str)] = embedded![
    "robots/asimo-arm/asimo-arm.urdf",
    "robots/asimo-arm/robot.toml",
    "tasks/cartesian-tracking.toml",
    "tasks/compliant-x.toml",
    "tasks/gravity-compensation.toml",
    "tasks/joint-tracking.toml",
    "tasks/suites/paper.toml",
];

/// The suite of the paper's experiments, among the embedded files.
pub const PAPER_SUITE: &str = "tasks/suites/paper.toml";

impl Files {
    /// Reads a text file.
    ///
    /// # Errors
    /// As [`Source::read`].
    pub fn read(self, path: &Path) -> Result<Source, FileError> {
        match self {
            Self::Disk => Source::read(path),
            Self::Embedded => {
                let found = EMBEDDED.iter().find(|(name, _)| Path::new(name) == path);
                found.map(|(name, text)| Source::new(*name, *text)).ok_or_else(|| {
                    let name = path.display().to_string();
                    FileError::of_file(name, "is not one of the files built into the program", None)
                })
            }
        }
    }

    /// Reads a text file to which `by` refers at `key`; an error about the file is reported at this key.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn read_named(self, path: &Path, by: &Source, key: impl KeyPath) -> Result<Source, FileError> {
        self.read(path).map_err(|error| {
            let message = format!("`{}`: {}", error.path(), error.message());
            FileError::at_key(by, key, message, error.help().map(str::to_owned))
        })
    }

    /// Kind of a file, if it can be read and its keys tell.
    #[must_use]
    pub fn kind(self, path: &Path) -> Option<Kind> {
        self.read(path).ok().and_then(|source| Kind::of(source.text()))
    }

    /// Returns the path of a robot file; for a folder, the path of the `robot.toml` in it.
    #[must_use]
    pub fn robot_file(self, path: &Path) -> PathBuf {
        let folder = match self {
            Self::Disk => path.is_dir(),
            Self::Embedded => path.extension().is_none(),
        };
        if folder { path.join("robot.toml") } else { path.to_owned() }
    }
}

/// Kind of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A robot: its `robot.toml`.
    Robot,
    /// A task.
    Task,
    /// A suite.
    Suite,
    /// An experiment with several robots.
    Experiment,
}

impl Kind {
    /// Returns the kind to which the top-level keys of a text belong; the rest of the text may be invalid. `None` if
    /// the text has no such keys, or keys of several kinds.
    #[must_use]
    pub fn of(text: &str) -> Option<Self> {
        const KEYS: [(Kind, &[&str]); 4] = [
            (
                Kind::Robot,
                &["urdf", "default_profile", "interface", "joint", "joint_defaults", "group", "simulated"],
            ),
            (Kind::Task, &["robot", "priority", "task", "environment"]),
            (Kind::Suite, &["title", "profiles", "grid", "grid_mode", "run"]),
            (Kind::Experiment, &["robots", "couplings", "channels"]),
        ];
        let mut tops = BTreeSet::new();
        let mut inside = false;
        for line in text.lines().map(str::trim_start) {
            let table = line.starts_with('[');
            if table || !inside {
                let word = line.trim_start_matches(['[', ' ', '"', '\'']);
                let key = word.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == '-'));
                tops.extend(key.take(1));
            }
            inside |= table;
        }
        let mut kinds = KEYS.iter().filter(|(_, keys)| keys.iter().any(|key| tops.contains(key)));
        match (kinds.next(), kinds.next()) {
            (Some((kind, _)), None) => Some(*kind),
            _ => None,
        }
    }

    /// Name of the kind in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Robot => "a robot file",
            Self::Task => "a task file",
            Self::Suite => "a suite file",
            Self::Experiment => "the file of an experiment with several robots",
        }
    }

    /// Checks that a text is of this kind, or that its kind cannot be determined.
    ///
    /// # Errors
    /// If the text is clearly of another kind.
    pub fn require(self, source: &Source) -> Result<(), FileError> {
        match Self::of(source.text()) {
            Some(kind) if kind != self => {
                let message = format!("is {}; {} is expected here", kind.name(), self.name());
                Err(FileError::of_file(source.name(), message, None))
            }
            _ => Ok(()),
        }
    }
}

/// Resolves a path in `file` that is relative to the folder of `file`.
#[must_use]
pub fn beside(file: &Path, relative: &Path) -> PathBuf {
    let mut path = file.parent().unwrap_or(Path::new("")).to_owned();
    for part in relative.components() {
        match part {
            Component::CurDir => {}
            // `..` can cancel a plain folder name without access to the disk, but no other component.
            Component::ParentDir if matches!(path.components().next_back(), Some(Component::Normal(_))) => {
                path.pop();
            }
            other => path.push(other),
        }
    }
    if path.as_os_str().is_empty() { PathBuf::from(".") } else { path }
}

#[cfg(test)]
mod tests {
    use super::{EMBEDDED, Kind, beside};
    use std::path::Path;

    #[test]
    fn paths_are_relative_to_their_file() {
        let from = |file: &str, relative: &str| beside(Path::new(file), Path::new(relative));
        assert_eq!(from("tasks/a.toml", "../robots/r"), Path::new("robots/r"));
        assert_eq!(from("a.toml", "../robots/r"), Path::new("../robots/r"));
        assert_eq!(from("../x/a.toml", "../../r"), Path::new("../../r"));
        assert_eq!(from("tasks/a.toml", "/abs/r"), Path::new("/abs/r"));
        assert_eq!(from("a.toml", "."), Path::new("."));
        assert_eq!(from("tasks/a.toml", ".."), Path::new("."));
    }

    #[test]
    fn file_kind_is_detected_from_keys() {
        for (path, text) in EMBEDDED.iter().filter(|(path, _)| path.ends_with(".toml")) {
            let kind = match path {
                _ if path.contains("suites") => Kind::Suite,
                _ if path.contains("robots") => Kind::Robot,
                _ => Kind::Task,
            };
            assert_eq!(Kind::of(text), Some(kind), "{path}");
        }
        assert_eq!(Kind::of("[workspace]\nmembers = []\n[profile.dev]\nurdf = 1"), None);
        assert_eq!(Kind::of("priority = "), Some(Kind::Task), "though it is no TOML");
        assert_eq!(Kind::of("duration_s = 1\n[robots.a]"), Some(Kind::Experiment));
        for quoted in ["\"robot\" = 1", "'priority' = []", "[\"task\".hand]", "[ 'task' . hand]"] {
            assert_eq!(Kind::of(quoted), Some(Kind::Task), "{quoted}");
        }
        assert_eq!(Kind::of("[a]\nrobot = 1"), None, "not at the top");
        assert_eq!(Kind::of("robot = 1\nurdf = 1"), None, "which of the two?");
    }
}
