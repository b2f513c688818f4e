//! Connection to a bus, with a clock.

use std::io;
use std::time::Duration;

/// Connection to a bus: a serial port, or a simulated bus. It has a clock, so that a simulated bus has a simulated time.
///
/// Times are since an origin of the connection's own. An implementation allocates nothing.
pub trait Transport {
    /// Time on the clock.
    fn now(&self) -> Duration;

    /// Returns when the clock has reached a time; at once if it has passed.
    fn wait_until(&mut self, time: Duration);

    /// Sends all bytes.
    ///
    /// # Errors
    /// If the bus is gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Receives what has arrived, and waits for it until the deadline. Returns the number of bytes; 0 if the deadline has passed
    /// and none has arrived. After the deadline it returns what has arrived already.
    ///
    /// # Errors
    /// If the bus is gone.
    fn receive(&mut self, buffer: &mut [u8], deadline: Duration) -> io::Result<usize>;

    /// Returns what else than the bus may cause its silence, as the end of a sentence; empty for a bus behind an adapter.
    fn other_cause_of_silence(&self) -> &'static str {
        ""
    }
}

impl<T: Transport + ?Sized> Transport for &mut T {
    fn now(&self) -> Duration {
        (**self).now()
    }

    fn wait_until(&mut self, time: Duration) {
        (**self).wait_until(time);
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        (**self).send(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Duration) -> io::Result<usize> {
        (**self).receive(buffer, deadline)
    }

    fn other_cause_of_silence(&self) -> &'static str {
        (**self).other_cause_of_silence()
    }
}
