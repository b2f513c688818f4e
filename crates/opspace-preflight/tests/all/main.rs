//! Tests of diagnostics and margins, on files that cause them.

use std::path::{Path, PathBuf};

mod diagnostics;
mod late_contact;
mod margins;
mod remedies;
mod reserves;
mod servo_gain;
mod singular_postures;
mod task_texts;

/// Path of a file of the project.
fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}
