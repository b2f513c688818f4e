//! Place of the MuJoCo library on this machine.

use crate::error::MujocoError;
use crate::ffi::is_library_name;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Environment variable with the path of the library.
pub const VARIABLE: &str = "OPSPACE_MUJOCO";

/// Prints the folder of the Python package, without importing it.
const SCRIPT: &str = "import importlib.util as u; s = u.find_spec('mujoco'); \
                      print(s.submodule_search_locations[0] if s else '')";

/// Returns the path of the library: that of the environment variable [`VARIABLE`], or that in the Python package `mujoco`
/// of the program `python3`.
///
/// # Errors
/// [`MujocoError::Missing`].
pub fn find_library() -> Result<PathBuf, MujocoError> {
    if let Some(path) = env::var_os(VARIABLE).filter(|path| !path.is_empty()) {
        return Ok(PathBuf::from(path));
    }
    ["python3", "python"].into_iter().find_map(library_of_python).ok_or(MujocoError::Missing)
}

/// Returns the library in the package of this Python.
fn library_of_python(python: &str) -> Option<PathBuf> {
    let output = Command::new(python).args(["-c", SCRIPT]).output().ok()?;
    let folder = String::from_utf8(output.stdout).ok()?;
    let files = fs::read_dir(Path::new(folder.trim_end())).ok()?;
    let libraries = files.filter_map(Result::ok).filter(|file| is_library_name(&file.file_name()));
    libraries.map(|file| file.path()).min()
}
