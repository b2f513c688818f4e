//! A connection to a simulated bus in the same program, with simulated time.

use crate::simulated::bus::SimulatedBus;
use crate::transport::Transport;
use std::io;
use std::time::Duration;

/// Connection to a simulated bus. Its clock advances only when a program waits: it needs no real time, and is repeated
/// exactly.
pub struct SimulatedTransport {
    /// Bus.
    pub bus: SimulatedBus,
    now: Duration,
}

impl SimulatedTransport {
    /// Returns a connection at time 0.
    #[must_use]
    pub fn new(bus: SimulatedBus) -> Self {
        Self { bus, now: Duration::ZERO }
    }

    fn check(&self) -> io::Result<()> {
        if self.bus.options.gone { Err(io::ErrorKind::BrokenPipe.into()) } else { Ok(()) }
    }
}

impl Transport for SimulatedTransport {
    fn now(&self) -> Duration {
        self.now
    }

    fn wait_until(&mut self, time: Duration) {
        self.now = self.now.max(time);
        self.bus.advance_to(self.now);
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check()?;
        self.bus.receive(bytes, self.now);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Duration) -> io::Result<usize> {
        self.check()?;
        let arrival = self.bus.next_arrival().filter(|arrival| *arrival <= deadline);
        self.wait_until(arrival.unwrap_or(deadline));
        Ok(self.bus.take(buffer, self.now))
    }
}
