//! Refusal of outputs that would overwrite an input or another output.

use crate::console::{Exit, Failure};
use std::fs;
use std::path::{Path, PathBuf};

/// Refuses an output that is the same file as an input or as another output, under whatever path. Devices and pipes
/// are not compared.
pub fn check_outputs(inputs: &[PathBuf], outputs: &[PathBuf]) -> Result<(), Failure> {
    let inputs: Vec<(&PathBuf, Option<FileId>)> =
        inputs.iter().map(|path| (path, FileId::of(path))).collect();
    let mut taken: Vec<(&PathBuf, FileId)> = Vec::new();
    for output in outputs {
        let Some(id) = FileId::of(output) else { continue };
        if inputs.iter().any(|(_, input)| input.as_ref() == Some(&id)) {
            return Err(refusal(output, "is an input of this command"));
        }
        if let Some((other, _)) = taken.iter().find(|(_, other)| *other == id) {
            return Err(refusal(output, &format!("would also be written as {}", other.display())));
        }
        taken.push((output, id));
    }
    Ok(())
}

fn refusal(output: &Path, reason: &str) -> Failure {
    Failure::Other(format!("{}: {reason}; choose another file for the output", output.display()), Exit::Bad)
}

/// Identity of a file, whatever links lead to it.
#[derive(PartialEq, Eq)]
enum FileId {
    /// Device and inode of an existing file.
    #[cfg(unix)]
    Inode(u64, u64),
    /// Path without links, of a file that does not exist yet or where there are no inodes.
    Path(PathBuf),
}

impl FileId {
    /// `None` for what is neither a regular file nor missing.
    fn of(path: &Path) -> Option<Self> {
        match fs::metadata(path) {
            Ok(metadata) if !metadata.is_file() => None,
            #[cfg(unix)]
            Ok(metadata) => {
                use std::os::unix::fs::MetadataExt;
                Some(Self::Inode(metadata.dev(), metadata.ino()))
            }
            #[cfg(not(unix))]
            Ok(_) => Some(Self::Path(resolved(path))),
            Err(_) => Some(Self::Path(resolved(path))),
        }
    }
}

/// The path with its longest existing part resolved.
fn resolved(path: &Path) -> PathBuf {
    if let Ok(resolved) = fs::canonicalize(path) {
        return resolved;
    }
    match (path.parent(), path.file_name()) {
        (Some(parent), Some(name)) if parent.as_os_str().is_empty() => resolved(Path::new(".")).join(name),
        (Some(parent), Some(name)) => resolved(parent).join(name),
        _ => path.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks pairs of paths of one file, by hard link, symbolic link, `..` and a folder that does not exist yet, and
    /// pairs of different files.
    #[test]
    #[cfg(unix)]
    fn output_that_is_input_or_other_output_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        fs::write(at("in"), "text").expect("a file");
        fs::hard_link(at("in"), at("hard")).expect("a link");
        std::os::unix::fs::symlink(at("in"), at("soft")).expect("a link");
        fs::create_dir(at("sub")).expect("a folder");
        let check = |inputs: &[&str], outputs: &[&str]| {
            let paths = |names: &[&str]| names.iter().map(|name| at(name)).collect::<Vec<_>>();
            check_outputs(&paths(inputs), &paths(outputs)).is_ok()
        };
        for output in ["in", "hard", "soft", "sub/../in"] {
            assert!(!check(&["in"], &[output]), "{output}");
        }
        assert!(!check(&[], &["new/a", "sub/../new/a"]) && !check(&[], &["hard", "soft"]));
        assert!(check(&["in"], &["other", "new/in", "new/other"]));
        let null = [PathBuf::from("/dev/null")];
        assert!(check_outputs(&null, &[null[0].clone(), null[0].clone()]).is_ok(), "a device");
    }
}
