//! Place of the MuJoCo library on this machine.
//!
//! Opening a library runs its code. It is therefore not looked for in the working folder, which may be a download.

use crate::error::MujocoError;
use crate::ffi::is_library_name;
use opspace_model::files::find_program;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Environment variable with the path of the library.
pub const VARIABLE: &str = "OPSPACE_MUJOCO";

/// Prints the folder of the Python package, without importing it, and the folders in which this Python installs packages.
///
/// Python runs isolated, that is, without the working folder and PYTHONPATH. Packages of the user are added again.
const SCRIPT: &str = "import importlib.util as u, site, sys
sys.path.append(site.getusersitepackages())
s = u.find_spec('mujoco')
print(s.submodule_search_locations[0] if s and s.submodule_search_locations else '')
print(sys.prefix)
print(site.getuserbase())";

/// Returns the path of the library: that of the environment variable [`VARIABLE`], or that in the Python package `mujoco`
/// of the program `python3`.
///
/// # Errors
/// [`MujocoError::Missing`], and [`MujocoError::InWorkingFolder`] for a library in the working folder that was not installed
/// by Python.
pub fn find_library() -> Result<PathBuf, MujocoError> {
    if let Some(path) = env::var_os(VARIABLE).filter(|path| !path.is_empty()) {
        return Ok(PathBuf::from(path));
    }
    let found = ["python3", "python"].into_iter().filter_map(find_program).find_map(|p| package_of(&p));
    let Some(Package { library, installed_in }) = found else { return Err(MujocoError::Missing) };
    if is_foreign(&library, &installed_in) {
        Err(MujocoError::InWorkingFolder { path: library })
    } else {
        Ok(library)
    }
}

/// Library in the package of a Python.
struct Package {
    library: PathBuf,
    /// Folders in which this Python installs packages.
    installed_in: Vec<PathBuf>,
}

/// Returns the library in the package of this Python.
fn package_of(python: &Path) -> Option<Package> {
    let output = Command::new(python).args(["-I", "-c", SCRIPT]).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let mut lines = text.lines();
    let folder = Path::new(lines.next()?);
    let files = fs::read_dir(folder).ok()?;
    let libraries = files.filter_map(Result::ok).filter(|file| is_library_name(&file.file_name()));
    let library = libraries.map(|file| file.path()).min()?.canonicalize().ok()?;
    Some(Package {
        library,
        installed_in: lines.filter_map(|line| Path::new(line).canonicalize().ok()).collect(),
    })
}

/// True for a library in the working folder that is in none of the folders of installed packages. A virtual environment
/// or the packages of a user may be in the working folder.
fn is_foreign(library: &Path, installed_in: &[PathBuf]) -> bool {
    let working = env::current_dir().and_then(|folder| folder.canonicalize());
    let is_in_working_folder = working.is_ok_and(|working| library.starts_with(working));
    is_in_working_folder && !installed_in.iter().any(|folder| library.starts_with(folder))
}
