//! Computations without Python's lock that Ctrl-C stops, and processes that were forked while one was going on.

use crate::errors::{of_panic, refused};
use opspace_experiment::Progress;
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

/// Time between two looks at the signals that Python has received.
const LOOK: Duration = Duration::from_millis(2);

/// Number of computations with threads of their own that are going on.
static RUNNING: AtomicUsize = AtomicUsize::new(0);

/// True if this process was forked while such a computation was going on: its locks may be held for ever.
static FORKED: AtomicBool = AtomicBool::new(false);

/// Notes that this process was forked; Python calls it in the child.
#[pyfunction]
#[pyo3(name = "_forked")]
pub(crate) fn forked() {
    if RUNNING.load(Ordering::Acquire) > 0 {
        FORKED.store(true, Ordering::Release);
    }
}

/// Counts a computation while it exists.
struct Running;

impl Running {
    fn begin() -> PyResult<Self> {
        if FORKED.load(Ordering::Acquire) {
            let help = "use multiprocessing.get_context(\"spawn\"), or fork before the first run";
            return Err(refused(
                "this process was forked while another thread of its parent was running an experiment",
                Some(help),
            ));
        }
        RUNNING.fetch_add(1, Ordering::AcqRel);
        Ok(Self)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        RUNNING.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Calls `body` in a thread of its own, without Python's lock. An exception of a signal handler, such as that of Ctrl-C, sets
/// the stop request of `progress`, and a second one its abort request; the first one is raised when `body` has returned.
///
/// # Errors
/// The exception of the signal handler; a panic of `body`; a process that was forked during a run.
pub(crate) fn interruptible<T: Send>(
    py: Python<'_>,
    progress: &Progress,
    body: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    let _running = Running::begin()?;
    // A signal that came before is not one of this run.
    py.check_signals()?;
    let (result, raised) = py.detach(|| {
        thread::scope(|scope| {
            let (done, wait) = channel::<()>();
            let thread = scope.spawn(move || {
                let _done = done;
                body()
            });
            let mut raised: Option<PyErr> = None;
            // The channel is closed when the body returns or panics.
            while wait.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                if let Err(error) = Python::attach(|py| py.check_signals()) {
                    let again = progress.interrupt.swap(true, Ordering::Relaxed);
                    progress.abort.fetch_or(again, Ordering::Relaxed);
                    raised.get_or_insert(error);
                }
            }
            (thread.join(), raised)
        })
    });
    let result = result.map_err(|panic| of_panic(&*panic));
    match raised {
        Some(error) => Err(error),
        None => result,
    }
}
