//! Bytes to packets.

use crate::protocol::packet::{HEADER, MAX_PACKET, MAX_PARAMETERS, Packet, checksum};

/// Bytes that a decoder holds at most: a packet that lacks its last byte, and as many bytes again.
const CAPACITY: usize = 2 * MAX_PACKET;

/// Finds packets in a stream of bytes that may be split, merged, damaged, or begin in the middle of a packet. Its memory is
/// bounded, and it allocates nothing.
///
/// ```
/// use opspace_feetech::protocol::{Decoded, Decoder, Packet};
///
/// let mut decoder = Decoder::default();
/// // A stray byte, and the first half of an answer of servo 1.
/// assert_eq!(decoder.push(&[0x07, 0xFF, 0xFF, 0x01]), 4);
/// assert_eq!(decoder.next_packet(), None);
/// assert_eq!(decoder.push(&[0x04, 0x00, 0x18, 0x05, 0xDD]), 5);
/// let packet = Packet { id: 1, code: 0, parameters: &[0x18, 0x05] };
/// assert_eq!(decoder.next_packet(), Some(Decoded::Packet(packet)));
/// ```
#[derive(Clone, Debug)]
pub struct Decoder {
    bytes: [u8; CAPACITY],
    start: usize,
    end: usize,
    max_parameters: usize,
    stray_bytes: u64,
}

/// A packet, or what is left of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decoded<'a> {
    /// A packet whose checksum is right.
    Packet(Packet<'a>),
    /// A packet whose checksum is wrong. The search goes on at its second byte, since its length may be wrong too.
    Damaged {
        /// Identifier in the packet; it may be wrong too.
        id: u8,
    },
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new(MAX_PARAMETERS)
    }
}

impl Decoder {
    /// Returns a decoder of packets with at most `max_parameters` bytes of parameters. A longer length is damage: the fewer
    /// are expected, the sooner a damaged length is found.
    #[must_use]
    pub fn new(max_parameters: usize) -> Self {
        let max_parameters = max_parameters.min(MAX_PARAMETERS);
        Self { bytes: [0; CAPACITY], start: 0, end: 0, max_parameters, stray_bytes: 0 }
    }

    /// Takes bytes, as many as there is room for, and returns their number. There is room for at least 259 after
    /// [`next_packet`](Self::next_packet) has returned `None`.
    #[must_use]
    pub fn push(&mut self, bytes: &[u8]) -> usize {
        self.bytes.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        let taken = bytes.len().min(CAPACITY - self.end);
        self.bytes[self.end..self.end + taken].copy_from_slice(&bytes[..taken]);
        self.end += taken;
        taken
    }

    /// Returns the next packet; `None` until more bytes arrive.
    pub fn next_packet(&mut self) -> Option<Decoded<'_>> {
        loop {
            let held = &self.bytes[self.start..self.end];
            let (size, id) = match held {
                [first, ..] if *first != HEADER[0] => {
                    self.skip();
                    continue;
                }
                [_, second, ..] if *second != HEADER[1] => {
                    self.skip();
                    continue;
                }
                // 255 is no identifier: a third byte of the header is a stray byte before it.
                [_, _, 0xFF, ..] => {
                    self.skip();
                    continue;
                }
                [_, _, id, length, ..] => {
                    let length = usize::from(*length);
                    if length < 2 || length > self.max_parameters + 2 {
                        self.skip();
                        continue;
                    }
                    (4 + length, *id)
                }
                _ => return None,
            };
            if held.len() < size {
                return None;
            }
            let start = self.start;
            if checksum(&self.bytes[start + 2..start + size - 1]) != self.bytes[start + size - 1] {
                self.start += 1;
                return Some(Decoded::Damaged { id });
            }
            self.start += size;
            let code = self.bytes[start + 4];
            let parameters = &self.bytes[start + 5..start + size - 1];
            return Some(Decoded::Packet(Packet { id, code, parameters }));
        }
    }

    /// Gives up the packet that lacks bytes, so that packets after a damaged length are found. Returns false if there is
    /// none. Call it when no further bytes are expected, and then [`next_packet`](Self::next_packet).
    pub fn give_up(&mut self) -> bool {
        let is_incomplete = self.start < self.end;
        if is_incomplete {
            self.skip();
        }
        is_incomplete
    }

    /// Forgets all bytes.
    pub fn clear(&mut self) {
        self.start = 0;
        self.end = 0;
    }

    /// Number of bytes so far that belonged to no packet.
    #[must_use]
    pub fn stray_bytes(&self) -> u64 {
        self.stray_bytes
    }

    /// Number of bytes that are held.
    #[must_use]
    pub fn held(&self) -> usize {
        self.end - self.start
    }

    fn skip(&mut self) {
        self.start += 1;
        self.stray_bytes += 1;
    }
}
