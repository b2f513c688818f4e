//! Errors when MuJoCo is opened.

use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Reason why MuJoCo cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MujocoError {
    /// No library was found.
    #[error(
        "MuJoCo is not installed; run `pip install mujoco`, or set OPSPACE_MUJOCO to the path of its library (libmujoco.so)"
    )]
    Missing,
    /// Library in the working folder, which is not opened unless it is named.
    #[error("{}: this library is in the working folder, and is not opened because its code may be anyone's; run `pip install mujoco`, or set OPSPACE_MUJOCO to this path", path.display())]
    InWorkingFolder {
        /// Path of the library.
        path: PathBuf,
    },
    /// File that is not a library of a supported version.
    #[error("{}: MuJoCo cannot be opened: {reason}; run `pip install --upgrade mujoco`, or correct OPSPACE_MUJOCO if it is set", path.display())]
    Library {
        /// Path of the file.
        path: PathBuf,
        /// Description of the cause.
        reason: String,
    },
    /// Scene that cannot be read.
    #[error("{}: the scene cannot be read: {source}", path.display())]
    Scene {
        /// Path of the scene.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
}
