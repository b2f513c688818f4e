//! Copies the robots and tasks of the repository to the folder of build outputs, from which maturin takes them into the wheel.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let out = env::var_os("OUT_DIR").map(PathBuf::from);
    let Some(out) = out else { return Err(io::Error::other("cargo sets OUT_DIR")) };
    let files = out.join("files");
    if files.exists() {
        fs::remove_dir_all(&files)?;
    }
    for folder in ["robots", "tasks"] {
        let from = Path::new("..").join(folder);
        println!("cargo::rerun-if-changed={}", from.display());
        copy(&from, &files.join(folder))?;
    }
    Ok(())
}

/// Copies a folder with all that is in it.
fn copy(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let path = entry?.path();
        let copied = to.join(path.file_name().unwrap_or_default());
        if path.is_dir() {
            copy(&path, &copied)?;
        } else {
            fs::copy(&path, &copied)?;
        }
    }
    Ok(())
}
