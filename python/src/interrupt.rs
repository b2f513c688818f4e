//! Computations without Python's lock that Ctrl-C stops, and processes that were forked while one was going on.

use crate::errors::{of_panic, refused, take_raised};
use opspace_experiment::Progress;
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
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

/// Stop and abort requests of the runs that are going on.
static STOPPABLE: Mutex<Vec<[Arc<AtomicBool>; 2]>> = Mutex::new(Vec::new());

/// Time in which the runs of other threads stop when Python exits; half of it for setpoints that brake.
const EXIT: Duration = Duration::from_secs(4);

/// Stops the runs of all threads; Python calls it before it exits, while their robots can still be commanded.
#[pyfunction]
#[pyo3(name = "_stop_all")]
pub(crate) fn stop_all(py: Python<'_>) {
    py.detach(|| {
        for request in 0..2 {
            let runs = STOPPABLE.lock().unwrap_or_else(PoisonError::into_inner).clone();
            runs.iter().for_each(|run| run[request].store(true, Ordering::Relaxed));
            let began = std::time::Instant::now();
            while RUNNING.load(Ordering::Acquire) > 0 && began.elapsed() < EXIT / 2 {
                thread::sleep(LOOK);
            }
        }
    });
}

/// Counts a computation while it exists.
struct Running([Arc<AtomicBool>; 2]);

impl Running {
    fn begin(progress: &Progress) -> PyResult<Self> {
        if FORKED.load(Ordering::Acquire) {
            let help = "use multiprocessing.get_context(\"spawn\"), or fork before the first run";
            return Err(refused(
                "this process was forked while another thread of its parent was running an experiment",
                Some(help),
            ));
        }
        let requests = [Arc::clone(&progress.interrupt), Arc::clone(&progress.abort)];
        STOPPABLE.lock().unwrap_or_else(PoisonError::into_inner).push(requests.clone());
        RUNNING.fetch_add(1, Ordering::AcqRel);
        Ok(Self(requests))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let mut stoppable = STOPPABLE.lock().unwrap_or_else(PoisonError::into_inner);
        stoppable.retain(|requests| !Arc::ptr_eq(&requests[0], &self.0[0]));
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
    let _running = Running::begin(progress)?;
    // A signal that came before is not one of this run.
    py.check_signals()?;
    let (result, raised) = py.detach(|| {
        thread::scope(|scope| {
            let (done, wait) = channel::<()>();
            let thread = scope.spawn(move || {
                let _done = done;
                let value = body();
                (value, take_raised())
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
    let (value, of_body) = result
        .map_err(|panic| of_panic(&*panic))
        .map_or_else(|error| (None, Some(error)), |(value, of_body)| (Some(value), of_body));
    match (raised.or(of_body), value) {
        (None, Some(value)) => Ok(value),
        (Some(error), _) => Err(error),
        (None, None) => Err(refused("the computation ended without a value", None)),
    }
}
