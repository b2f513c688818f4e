//! Signals: a safe stop of a run on Ctrl-C or a termination request, and errors in place of a signal at a limit of file
//! sizes.

use opspace_experiment::Progress;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::sync::Arc;

/// Returns a progress whose run stops safely when the user or a batch system interrupts the program.
pub fn watch() -> Arc<Progress> {
    let watch = Arc::new(Progress::default());
    for signal in [SIGINT, SIGTERM] {
        // Without the handler the signal ends the program at once; the log is readable up to then.
        let _ = flag::register(signal, Arc::clone(&watch.interrupt));
    }
    // With a handler, whatever it does, a write beyond the limit fails in place of ending the program.
    #[cfg(unix)]
    let _ = flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
    watch
}
