//! Packets as bytes.

use crate::protocol::error_flags::ErrorFlags;
use crate::protocol::packet::{BROADCAST_ID, HEADER, Instruction, MAX_PACKET, MAX_PARAMETERS, checksum};

/// Writes packets into a buffer of its own. Allocates nothing.
#[derive(Clone, Debug)]
pub struct Encoder {
    bytes: [u8; MAX_PACKET],
    length: usize,
}

/// A packet with more than 253 bytes of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a packet has at most 253 bytes of parameters")]
pub struct TooLong;

impl Default for Encoder {
    fn default() -> Self {
        Self { bytes: [0; MAX_PACKET], length: 0 }
    }
}

impl Encoder {
    /// Returns the request that asks a servo for an answer; [`BROADCAST_ID`] asks all.
    pub fn ping(&mut self, id: u8) -> &[u8] {
        self.begin(id, Instruction::Ping.code());
        self.finish()
    }

    /// Returns the request that reads `length` bytes of a servo from an address on.
    pub fn read(&mut self, id: u8, address: u8, length: u8) -> &[u8] {
        self.begin(id, Instruction::Read.code());
        self.append(&[address, length]);
        self.finish()
    }

    /// Returns the request that writes bytes to a servo from an address on.
    ///
    /// # Errors
    /// If there are more than 252 bytes.
    pub fn write(&mut self, id: u8, address: u8, data: &[u8]) -> Result<&[u8], TooLong> {
        check(1 + data.len())?;
        self.begin(id, Instruction::Write.code());
        self.append(&[address]);
        self.append(data);
        Ok(self.finish())
    }

    /// Returns the request that reads `length` bytes of several servos from an address on.
    ///
    /// # Errors
    /// If there are more than 251 servos.
    pub fn sync_read(&mut self, address: u8, length: u8, ids: &[u8]) -> Result<&[u8], TooLong> {
        check(2 + ids.len())?;
        self.begin(BROADCAST_ID, Instruction::SyncRead.code());
        self.append(&[address, length]);
        self.append(ids);
        Ok(self.finish())
    }

    /// Returns the request that writes `N` bytes to each of several servos from an address on.
    ///
    /// # Errors
    /// If the parameters are more than 253 bytes.
    pub fn sync_write<const N: usize>(
        &mut self,
        address: u8,
        values: impl ExactSizeIterator<Item = (u8, [u8; N])>,
    ) -> Result<&[u8], TooLong> {
        check(2 + values.len() * (1 + N))?;
        self.begin(BROADCAST_ID, Instruction::SyncWrite.code());
        self.append(&[address, u8::try_from(N).map_err(|_| TooLong)?]);
        for (id, data) in values {
            self.append(&[id]);
            self.append(&data);
        }
        Ok(self.finish())
    }

    /// Returns the answer of a servo.
    ///
    /// # Errors
    /// If there are more than 253 bytes.
    pub fn answer(&mut self, id: u8, flags: ErrorFlags, data: &[u8]) -> Result<&[u8], TooLong> {
        check(data.len())?;
        self.begin(id, flags.bits());
        self.append(data);
        Ok(self.finish())
    }

    fn begin(&mut self, id: u8, code: u8) {
        self.length = 0;
        self.append(&HEADER);
        self.append(&[id, 0, code]);
    }

    /// Appends bytes; an iterator that is longer than it says is cut off.
    fn append(&mut self, bytes: &[u8]) {
        let room = &mut self.bytes[self.length..MAX_PACKET - 1];
        let taken = bytes.len().min(room.len());
        room[..taken].copy_from_slice(&bytes[..taken]);
        self.length += taken;
    }

    fn finish(&mut self) -> &[u8] {
        // At most 255: code, 253 parameters, checksum.
        self.bytes[3] = u8::try_from(self.length - 3).unwrap_or(u8::MAX);
        self.bytes[self.length] = checksum(&self.bytes[2..self.length]);
        &self.bytes[..=self.length]
    }
}

fn check(parameters: usize) -> Result<(), TooLong> {
    if parameters > MAX_PARAMETERS { Err(TooLong) } else { Ok(()) }
}
