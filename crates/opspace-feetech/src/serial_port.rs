//! A serial port of Linux. Other systems are not supported yet: macOS has another call for a baud rate of 1 MHz, and
//! Windows another interface.

use crate::transport::Transport;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, fstat, major, minor};
use rustix::io::Errno;
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, SpecialCodeIndex, ioctl_tiocexcl, ioctl_tiocnxcl, tcflush,
    tcgetattr, tcsetattr,
};
use std::io;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::time::{Duration, Instant};

/// Time within which the system must take a packet.
const SEND_WITHIN: Duration = Duration::from_millis(100);

/// A serial port in raw mode, eight bits without parity, used by this program alone.
#[derive(Debug)]
pub struct SerialPort {
    file: OwnedFd,
    origin: Instant,
    /// True for a pseudo-terminal, behind which another program simulates a bus.
    is_pseudo_terminal: bool,
}

/// Reason why a serial port cannot be opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PortError {
    /// The file cannot be opened.
    #[error("{0}")]
    Open(#[source] io::Error),
    /// Another program uses the port.
    #[error("the port is used by another program{}", .process.map_or_else(String::new, |process| format!(", process {process}")))]
    Used {
        /// Number of its process, if it is known.
        process: Option<u32>,
    },
    /// The file is no serial port.
    #[error("it is no serial port: {0}")]
    NoTerminal(#[source] io::Error),
    /// The port does not take this baud rate.
    #[error("the port does not take {baud_hz} baud; it takes {taken}")]
    Baud {
        /// Baud rate that was asked for.
        baud_hz: u32,
        /// Baud rate of the port.
        taken: u32,
    },
}

impl SerialPort {
    /// Opens a serial port, such as `/dev/ttyACM0`. What has arrived before is discarded.
    ///
    /// # Errors
    /// If it does not exist, is used by another program, is no serial port, or does not take the baud rate.
    pub fn open(path: &Path, baud_hz: u32) -> Result<Self, PortError> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| match error {
            Errno::BUSY => PortError::Used { process: None },
            error => PortError::Open(error.into()),
        })?;
        let no_terminal = |error: Errno| PortError::NoTerminal(error.into());
        // The lock also keeps out programs of the superuser, who may open a port that is in exclusive use. It ends with the file.
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) => return Err(PortError::Used { process: holder_of_lock(&file) }),
            Err(error) => return Err(PortError::Open(error.into())),
        }
        let mut modes = tcgetattr(&file).map_err(no_terminal)?;
        ioctl_tiocexcl(&file).map_err(no_terminal)?;
        modes.make_raw();
        modes.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
        modes.control_modes -= ControlModes::CSTOPB | ControlModes::CRTSCTS | ControlModes::HUPCL;
        // A read without data fails, so that one of no bytes is the end.
        modes.special_codes[SpecialCodeIndex::VMIN] = 1;
        modes.special_codes[SpecialCodeIndex::VTIME] = 0;
        modes.set_speed(baud_hz).map_err(no_terminal)?;
        tcsetattr(&file, OptionalActions::Now, &modes).map_err(no_terminal)?;
        let taken = tcgetattr(&file).map_err(no_terminal)?.output_speed();
        // Rates of adapters are fractions of their clocks; a servo tolerates 2 %.
        if taken.abs_diff(baud_hz) > baud_hz / 50 {
            return Err(PortError::Baud { baud_hz, taken });
        }
        tcflush(&file, QueueSelector::IOFlush).map_err(no_terminal)?;
        let is_pseudo_terminal = std::fs::canonicalize(path).is_ok_and(|path| path.starts_with("/dev/pts"));
        Ok(Self { file, origin: Instant::now(), is_pseudo_terminal })
    }

    /// Waits for an event until a deadline.
    fn wait(&self, events: PollFlags, deadline: Duration) -> io::Result<()> {
        let timeout = deadline.saturating_sub(self.now());
        let timeout =
            Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
        let mut files = [PollFd::new(&self.file, events)];
        match poll(&mut files, Some(&timeout)) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        let found = files[0].revents();
        let is_gone = found.intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL);
        if is_gone && !found.contains(events) { Err(io::ErrorKind::BrokenPipe.into()) } else { Ok(()) }
    }
}

/// Number of the process that has locked a file, from the system's list of locks: `1: FLOCK ADVISORY WRITE 4711 00:18:5 0 EOF`.
fn holder_of_lock(file: &OwnedFd) -> Option<u32> {
    let status = fstat(file).ok()?;
    let place = format!("{:02x}:{:02x}:{}", major(status.st_dev), minor(status.st_dev), status.st_ino);
    let locks = std::fs::read_to_string("/proc/locks").ok()?;
    let lock = locks.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let of_file = lock.into_iter().find(|fields| fields.get(5).is_some_and(|found| *found == place))?;
    of_file.get(4)?.parse().ok()
}

impl Drop for SerialPort {
    /// Lets other programs open the port, also if one keeps it open, as a simulated bus does.
    fn drop(&mut self) {
        // Without effect on a port that is gone.
        let _ = ioctl_tiocnxcl(&self.file);
    }
}

impl Transport for SerialPort {
    fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    fn wait_until(&mut self, time: Duration) {
        std::thread::sleep(time.saturating_sub(self.now()));
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let deadline = self.now() + SEND_WITHIN;
        let mut rest = bytes;
        while !rest.is_empty() {
            match rustix::io::write(&self.file, rest) {
                Ok(sent) => rest = &rest[sent..],
                Err(Errno::AGAIN) if self.now() < deadline => self.wait(PollFlags::OUT, deadline)?,
                Err(Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Duration) -> io::Result<usize> {
        loop {
            match rustix::io::read(&self.file, &mut *buffer) {
                Ok(0) => return Err(io::ErrorKind::BrokenPipe.into()),
                Ok(received) => return Ok(received),
                Err(Errno::AGAIN) if self.now() >= deadline => return Ok(0),
                Err(Errno::AGAIN) => self.wait(PollFlags::IN, deadline)?,
                Err(Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn other_cause_of_silence(&self) -> &'static str {
        if self.is_pseudo_terminal {
            "; the port is a pseudo-terminal, and a simulated bus is silent too while the computer is busy"
        } else {
            ""
        }
    }
}
