//! Folders and files of results: locked against other processes, and written whole or not at all.

use crate::run::error::RunError;
use opspace_log::MAGIC;
use opspace_model::files::open_file;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

/// File name of a run's log.
pub const LOG: &str = "run.mcap";
/// File name of the page of a run or a suite.
pub const REPORT: &str = "report.html";
/// File name of a run's summary.
pub const SUMMARY: &str = "summary.json";

/// Number of times that a folder which is moved while it is locked is tried again.
const ATTEMPTS: usize = 100;

/// A folder of results, locked as long as this value lives: no other process can open it, move it aside or clear it by
/// opspace.
///
/// The lock is an advisory one on the folder itself, and needs no file. Where the system cannot lock a folder (Windows,
/// some network file systems), there is none.
#[derive(Debug)]
pub struct ResultFolder {
    path: PathBuf,
    _lock: Option<File>,
}

impl ResultFolder {
    /// Creates the folder if it does not exist, and locks it.
    ///
    /// # Errors
    /// A folder that another process has locked, or that can't be created.
    pub fn open(path: &Path) -> Result<Self, RunError> {
        let failed = |source| RunError::Write { path: path.to_owned(), source };
        for _ in 0..ATTEMPTS {
            fs::create_dir_all(path).map_err(failed)?;
            let Ok(handle) = File::open(path) else { break };
            match handle.try_lock() {
                Ok(()) if is_at(&handle, path) => {
                    return Ok(Self { path: path.to_owned(), _lock: Some(handle) });
                }
                // Another process has moved the folder aside between the two calls.
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Err(RunError::Locked { path: path.to_owned() }),
                Err(TryLockError::Error(_)) => break,
            }
        }
        Ok(Self { path: path.to_owned(), _lock: None })
    }

    /// Path of the folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// True if the path denotes the open file.
#[cfg(unix)]
fn is_at(handle: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |metadata: fs::Metadata| (metadata.dev(), metadata.ino());
    let (open, now) = (handle.metadata().map(identity), fs::metadata(path).map(identity));
    matches!((open, now), (Ok(open), Ok(now)) if open == now)
}

#[cfg(not(unix))]
fn is_at(_handle: &File, _path: &Path) -> bool {
    true
}

/// Writes a text file: a complete one takes the place of an existing one, or nothing changes. A device or a pipe
/// (`/dev/null`) is written to directly.
///
/// # Errors
/// A file that can't be written; an existing log, which is never overwritten.
pub fn write_file(path: &Path, text: &str) -> io::Result<()> {
    write_file_with(path, |file| file.write_all(text.as_bytes()))
}

/// Writes a file like [`write_file`], with the content that `write` writes.
///
/// # Errors
/// As [`write_file`], and errors of `write`.
pub fn write_file_with(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let existing = fs::metadata(path).ok();
    if existing.as_ref().is_some_and(|metadata| !metadata.is_file()) {
        return write(&mut File::create(path)?);
    }
    // Not the link itself is replaced, but the file that it denotes.
    let path = if existing.is_some() { fs::canonicalize(path)? } else { path.to_owned() };
    if existing.is_some() && is_log(&path)? {
        return Err(io::Error::other("it is a log, and logs are never overwritten"));
    }
    replace_file(&path, write)
}

/// Writes a file aside, under a name that no other process uses, and renames it: a complete file takes the place of an
/// existing one, or nothing changes. The file that `write` gets can be read too.
///
/// # Errors
/// A file that can't be written, and errors of `write`.
pub fn replace_file(path: &Path, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Processes of different machines may have the same number: the time tells them apart, and a taken name is refused.
    let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_nanos());
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let aside = path.with_file_name(format!(".{name}.{}.{time}.{number}", std::process::id()));
    let written = File::options()
        .read(true)
        .write(true)
        .create_new(true)
        .open(&aside)
        .and_then(|mut file| write(&mut file))
        .and_then(|()| fs::rename(&aside, path));
    if written.is_err() {
        let _ = fs::remove_file(&aside);
    }
    written
}

/// Removes the files that [`replace_file`] was writing in a folder when its process was killed. The lock of the folder keeps
/// other commands from writing there; a process that lives is spared nevertheless.
pub fn remove_leftovers(folder: &ResultFolder) {
    let entries = fs::read_dir(folder.path()).into_iter().flatten().flatten();
    let written_by = |name: &str| -> Option<u32> {
        let (rest, number) = name.strip_prefix('.')?.rsplit_once('.')?;
        let (rest, time) = rest.rsplit_once('.')?;
        let (_, process) = rest.rsplit_once('.')?;
        number.parse::<u64>().ok()?;
        time.parse::<u128>().ok()?;
        process.parse().ok()
    };
    for entry in entries {
        let process = entry.file_name().to_str().and_then(written_by);
        if process.is_some_and(|process| !is_alive(process)) {
            // One that cannot be removed does no harm.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// True unless the system says that there is no such process.
fn is_alive(process: u32) -> bool {
    let processes = Path::new("/proc");
    !processes.join("self").exists() || processes.join(process.to_string()).exists()
}

/// True for a file that begins as an MCAP file does.
fn is_log(path: &Path) -> io::Result<bool> {
    use io::Read;
    let mut head = Vec::new();
    open_file(path)?.take(MAGIC.len() as u64).read_to_end(&mut head)?;
    Ok(head == MAGIC)
}
