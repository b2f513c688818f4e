//! Signals: a safe stop of a run at the first one, the robots' own stop at the second one, and errors in place of a signal at a
//! limit of file sizes.

use crate::console::Exit;
use opspace_experiment::Progress;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Signals that would end the program and can be caught.
#[cfg(unix)]
const ENDING: &[i32] = {
    use signal_hook::consts::{
        SIGALRM, SIGHUP, SIGIO, SIGPROF, SIGQUIT, SIGUSR1, SIGUSR2, SIGVTALRM, SIGXCPU,
    };
    &[SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1, SIGUSR2, SIGALRM, SIGVTALRM, SIGPROF, SIGIO, SIGXCPU]
};
#[cfg(not(unix))]
const ENDING: &[i32] = &[SIGINT, SIGTERM];

/// Returns a progress whose run stops safely when the user or a batch system interrupts the program.
pub fn watch() -> Arc<Progress> {
    watch_for(ENDING)
}

/// Returns a progress as [`watch`] does, for a run on real robots. It also stops when the program would be suspended (Ctrl-Z),
/// with a robot on its last command.
pub fn watch_with_robots() -> Arc<Progress> {
    #[cfg(unix)]
    return watch_for(&[ENDING, &[signal_hook::consts::SIGTSTP]].concat());
    #[cfg(not(unix))]
    watch_for(ENDING)
}

fn watch_for(signals: &[i32]) -> Arc<Progress> {
    let watch = Arc::new(Progress::default());
    catch(signals, &watch);
    // With a handler, whatever it does, a write beyond the limit fails in place of ending the program.
    #[cfg(unix)]
    let _ = flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
    watch
}

/// Counts signals in a thread of its own. The first one asks for a stop, the second one for the robots' own stop; if no robot
/// moves, or at the third one, the program ends at once.
#[cfg(unix)]
fn catch(signals: &[i32], watch: &Arc<Progress>) {
    // Without the handler a signal ends the program at once; the log is readable up to then.
    let Ok(mut caught) = signal_hook::iterator::Signals::new(signals) else { return };
    let counted = Arc::clone(watch);
    let count = move || {
        for (number, _) in caught.forever().enumerate() {
            match number {
                0 => counted.interrupt.store(true, Ordering::Relaxed),
                1 if counted.is_driving() => counted.abort.store(true, Ordering::Relaxed),
                _ => std::process::exit(Exit::Interrupted.code().into()),
            }
        }
    };
    // Without the thread, signals are lost: they must end the program instead.
    let thread = std::thread::Builder::new().name("opspace-signals".to_owned());
    if thread.spawn(count).is_err() {
        for &signal in signals {
            let _ = flag::register(signal, Arc::clone(&watch.interrupt));
        }
    }
}

#[cfg(not(unix))]
fn catch(signals: &[i32], watch: &Arc<Progress>) {
    for &signal in signals {
        // Without the handler the signal ends the program at once; the log is readable up to then.
        let _ = flag::register(signal, Arc::clone(&watch.interrupt));
    }
}
