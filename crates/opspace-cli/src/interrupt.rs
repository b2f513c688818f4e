//! Safe stop of a run on Ctrl-C.

use opspace_experiment::Progress;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Returns a progress object that requests a safe stop when the user interrupts the program.
pub fn watch() -> Arc<Progress> {
    let watch = Arc::new(Progress::default());
    let seen = Arc::clone(&watch);
    // Without the handler, Ctrl-C ends the program immediately; the log is readable up to this time.
    let _ = ctrlc::set_handler(move || seen.interrupt.store(true, Ordering::Relaxed));
    watch
}
