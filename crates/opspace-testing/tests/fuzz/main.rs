//! Fuzz targets: every reader of a user's file gets files of the repository with random edits.
//!
//! A target checks that the reader does not panic, ends, and needs little memory; that an error names its file and
//! place; and that everything which the reader accepts has properties that damage would break: finite numbers, the same
//! value after it was written and read again, the same rows. `BOLERO_RANDOM_ITERATIONS` and
//! `BOLERO_RANDOM_TEST_TIME_MS` limit the number of inputs and the time of each target, `BOLERO_RANDOM_SEED` repeats an
//! input that failed, and with `OPSPACE_FUZZ_REPEATABLE` the inputs are the same every time. A failed input is also
//! written to the folder of temporary files.

mod edits;
mod inputs;
mod limits;
mod live;
mod log;
mod mcap_file;
mod mesh;
mod messages;
mod overrides;
mod recorded;
mod results;
mod robot;
mod samples;
mod servo_bus;
// Compiled here, so that these tests need not wait for the command line.
#[path = "../../../opspace-cli/src/samples.rs"]
mod states;
mod suite;
mod task;
mod urdf;

use opspace_experiment::Source;
use std::path::{Path, PathBuf};

#[global_allocator]
static ALLOCATOR: opspace_testing::allocation::CountingAllocator =
    opspace_testing::allocation::CountingAllocator;

/// Returns the path of a file of the repository.
fn root(path: &str) -> PathBuf {
    // Without `..`, so that paths in messages are short.
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).parent().and_then(Path::parent);
    crates.expect("the root of the repository").join(path)
}

/// Returns the text of a file of the repository.
fn text(path: &str) -> String {
    Source::read(root(path)).unwrap_or_else(|error| panic!("{error}")).text().to_owned()
}

/// Returns the texts of the files of a folder of the repository with that ending, sorted by path.
fn texts(folder: &str, ending: &str) -> Vec<String> {
    files(folder, ending).iter().map(|path| text(path)).collect()
}

/// Returns the paths of the files of a folder of the repository with that ending, sorted.
fn files(folder: &str, ending: &str) -> Vec<String> {
    let entries = std::fs::read_dir(root(folder)).expect("a folder of the repository");
    let names = entries.map(|entry| entry.expect("a file").file_name().to_string_lossy().into_owned());
    let mut paths: Vec<String> =
        names.filter(|name| name.ends_with(ending)).map(|name| format!("{folder}/{name}")).collect();
    paths.sort();
    assert!(!paths.is_empty(), "{folder} has no {ending}");
    paths
}

/// Folder of the seeds that are not files of robots and tasks of the repository.
const CORPUS: &str = "crates/opspace-testing/tests/fuzz/corpus";
