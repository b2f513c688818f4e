//! A simulated bus as a serial port that other programs open: a pseudo-terminal.

use crate::simulated::bus::SimulatedBus;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest time for which the thread waits for a request.
const TICK: Duration = Duration::from_millis(1);

/// Pause of the simulation after which a request that has come meanwhile counts as late: most of the time that a driver of 100 Hz
/// waits for answers.
const LATE: Duration = Duration::from_millis(5);

/// A simulated bus behind a pseudo-terminal, in real time, in a thread of its own. It ends when it is dropped.
///
/// Its baud rate does not matter to the system; [`BusOptions`](crate::simulated::BusOptions) says how long bytes take.
pub struct PseudoTerminal {
    path: PathBuf,
    link: Option<PathBuf>,
    bus: Arc<Mutex<SimulatedBus>>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

/// State that the thread shares with its owner.
#[derive(Default)]
struct Shared {
    is_over: AtomicBool,
    longest_pause_us: AtomicU64,
    late_requests: AtomicU64,
}

impl PseudoTerminal {
    /// Opens a pseudo-terminal, and simulates the bus behind it.
    ///
    /// # Errors
    /// If the system has no pseudo-terminal.
    pub fn open(bus: SimulatedBus) -> io::Result<Self> {
        let controller = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&controller)?;
        unlockpt(&controller)?;
        let name = ptsname(&controller, Vec::new())?;
        let path = PathBuf::from(name.into_string().map_err(|_| io::ErrorKind::InvalidData)?);
        // Open as long as the thread runs, so that programs may come and go.
        let port = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        let mut modes = tcgetattr(&port)?;
        modes.make_raw();
        tcsetattr(&port, OptionalActions::Now, &modes)?;
        rustix::fs::fcntl_setfl(&controller, OFlags::RDWR | OFlags::NONBLOCK)?;
        let (bus, shared) = (Arc::new(Mutex::new(bus)), Arc::new(Shared::default()));
        let (of_thread, shared_with_thread) = (Arc::clone(&bus), Arc::clone(&shared));
        let thread = std::thread::spawn(move || {
            serve(controller, &of_thread, &shared_with_thread);
            drop(port);
        });
        Ok(Self { path, link: None, bus, shared, thread: Some(thread) })
    }

    /// Makes a symbolic link to the port, which is removed at the end. A link that leads nowhere is replaced.
    ///
    /// # Errors
    /// If the path exists, or cannot be written.
    pub fn with_link(mut self, link: &Path) -> io::Result<Self> {
        if link.is_symlink() && !link.exists() {
            std::fs::remove_file(link)?;
        }
        std::os::unix::fs::symlink(&self.path, link)?;
        self.link = Some(link.to_owned());
        Ok(self)
    }

    /// Path of the port.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Longest time for which the system did not let the simulation run: a servo does not answer meanwhile. On an idle machine it is
    /// little more than a millisecond.
    #[must_use]
    pub fn longest_pause(&self) -> Duration {
        Duration::from_micros(self.shared.longest_pause_us.load(Ordering::Relaxed))
    }

    /// Number of requests that were found after a pause of more than 5 ms: their answers are late by up to the pause, as the system
    /// did not let the simulation run. Nothing is wrong with the simulated servos.
    #[must_use]
    pub fn late_requests(&self) -> u64 {
        self.shared.late_requests.load(Ordering::Relaxed)
    }

    /// Bus, to be looked at or changed; the simulation waits for as long as it is held.
    pub fn bus(&self) -> MutexGuard<'_, SimulatedBus> {
        self.bus.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for PseudoTerminal {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been said.
            let _ = thread.join();
        }
        if let Some(link) = &self.link
            && std::fs::read_link(link).is_ok_and(|target| target == self.path)
        {
            let _ = std::fs::remove_file(link);
        }
    }
}

/// Passes bytes between the pseudo-terminal and the bus until the end, or until the port is gone.
fn serve(controller: OwnedFd, bus: &Mutex<SimulatedBus>, shared: &Shared) {
    let origin = Instant::now();
    let mut buffer = [0; 512];
    let mut before = origin.elapsed();
    while !shared.is_over.load(Ordering::Relaxed) {
        let mut wait = TICK;
        {
            let mut bus = bus.lock().unwrap_or_else(PoisonError::into_inner);
            let pause = origin.elapsed() - before;
            before += pause;
            shared.longest_pause_us.fetch_max(pause.as_micros() as u64, Ordering::Relaxed);
            if bus.options.gone {
                return;
            }
            let now = origin.elapsed();
            bus.advance_to(now);
            let count = bus.take(&mut buffer, now);
            // What the port does not take is lost, as nobody reads it.
            let _ = rustix::io::write(&controller, &buffer[..count]);
            match rustix::io::read(&controller, &mut buffer) {
                Ok(received) => {
                    shared.late_requests.fetch_add(u64::from(pause > LATE), Ordering::Relaxed);
                    bus.receive(&buffer[..received], origin.elapsed());
                }
                Err(Errno::AGAIN | Errno::INTR | Errno::IO) => {}
                Err(_) => return,
            }
            if let Some(arrival) = bus.next_arrival() {
                wait = wait.min(arrival.saturating_sub(origin.elapsed()));
            }
        }
        if wait > Duration::ZERO {
            let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(wait.subsec_nanos()) };
            // An error is found by the next read.
            let _ = poll(&mut [PollFd::new(&controller, PollFlags::IN)], Some(&timeout));
        }
    }
}
