//! The command line, for the console script.

use crate::errors::caught;
use opspace_cli::{Extensions, main_with_args};
use pyo3::prelude::*;
use std::ffi::OsString;
use std::io::{Write, stdout};
use std::process::ExitCode;

/// Runs the command line `opspace` with these arguments, the first of which is the name of the program, and returns its exit
/// code. Invalid arguments and `--help` end the process.
#[pyfunction]
pub(crate) fn main(py: Python<'_>, args: Vec<OsString>) -> PyResult<u8> {
    let code = py.detach(|| {
        caught(|| {
            let code = main_with_args(Extensions::default(), args);
            // Rust flushes at the end of its own `main` only.
            let _ = stdout().flush();
            code
        })
    })?;
    Ok((0..=u8::MAX).find(|&number| ExitCode::from(number) == code).unwrap_or(1))
}
