//! Where files are read from: the disk, or the examples inside the binary.

use crate::source::{FileError, Source};
use std::path::{Component, Path, PathBuf};

/// A place to read files from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Files {
    /// The disk, relative to the working directory.
    Disk,
    /// The paper's robot, tasks and suite, carried in the binary under the paths they have in the project.
    Embedded,
}

macro_rules! embedded {
    ($($path:literal),* $(,)?) => {
        &[$(($path, include_str!(concat!("../../../", $path)))),*]
    };
}

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
                    FileError::of_file(name, "is not one of the files inside the program", None)
                })
            }
        }
    }

    /// The file that a robot is named by: a folder stands for the `robot.toml` in it.
    #[must_use]
    pub fn robot_file(self, path: &Path) -> PathBuf {
        let folder = match self {
            Self::Disk => path.is_dir(),
            Self::Embedded => path.extension().is_none(),
        };
        if folder { path.join("robot.toml") } else { path.to_owned() }
    }
}

/// The path that stands in a file as `relative`, which counts from that file's folder.
#[must_use]
pub fn beside(file: &Path, relative: &Path) -> PathBuf {
    let mut path = file.parent().unwrap_or(Path::new("")).to_owned();
    for part in relative.components() {
        match part {
            Component::CurDir => {}
            // Only what is a plain folder can be stepped back from without asking the disk.
            Component::ParentDir if matches!(path.components().next_back(), Some(Component::Normal(_))) => {
                path.pop();
            }
            other => path.push(other),
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use super::beside;
    use std::path::Path;

    #[test]
    fn paths_in_a_file_count_from_its_folder() {
        let from = |file: &str, relative: &str| beside(Path::new(file), Path::new(relative));
        assert_eq!(from("tasks/a.toml", "../robots/r"), Path::new("robots/r"));
        assert_eq!(from("a.toml", "../robots/r"), Path::new("../robots/r"));
        assert_eq!(from("../x/a.toml", "../../r"), Path::new("../../r"));
        assert_eq!(from("tasks/a.toml", "/abs/r"), Path::new("/abs/r"));
    }
}
