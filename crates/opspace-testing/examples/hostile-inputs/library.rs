//! Readers of the library in this process: a panic is caught, and a reader that does not end ends the trial.

use crate::program::LONGEST;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Begin of what is read, by its name.
static READING: Mutex<BTreeMap<String, Instant>> = Mutex::new(BTreeMap::new());

/// Calls a reader.
///
/// # Errors
/// The words of a panic.
pub fn read<T>(name: &str, reader: impl FnOnce() -> T) -> Result<T, String> {
    let reading = || READING.lock().unwrap_or_else(PoisonError::into_inner);
    reading().insert(name.to_owned(), Instant::now());
    let outcome = catch_unwind(AssertUnwindSafe(reader));
    reading().remove(name);
    outcome.map_err(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
        format!("the library panicked: {}", text.unwrap_or_default())
    })
}

/// Ends this process if a reader takes too long: an endless loop cannot be ended otherwise.
#[expect(clippy::print_stdout, reason = "a program for the terminal")]
pub fn watch() {
    thread::spawn(|| {
        loop {
            thread::sleep(Duration::from_secs(1));
            let reading = READING.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((name, _)) = reading.iter().find(|(_, begun)| begun.elapsed() > LONGEST) {
                println!("{name} FAILED: no end after {LONGEST:?}");
                std::process::exit(1);
            }
        }
    });
}
