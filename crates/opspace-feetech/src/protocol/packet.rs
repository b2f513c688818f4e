//! Packets and instructions.

/// Identifier of a request to all servos.
pub const BROADCAST_ID: u8 = 0xFE;

/// Largest identifier of a servo.
pub const MAX_ID: u8 = 0xFD;

/// Size of the longest packet, bytes: the header, the identifier, and a length of 255 with what it counts.
pub const MAX_PACKET: usize = 4 + 255;

/// Largest number of parameters of a packet.
pub const MAX_PARAMETERS: usize = 253;

/// First two bytes of each packet.
pub(crate) const HEADER: [u8; 2] = [0xFF, 0xFF];

/// A packet whose checksum is right: a request or an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Identifier of the servo that is asked, or that answers.
    pub id: u8,
    /// Instruction of a request, error flags of an answer.
    pub code: u8,
    /// Parameters; those of an answer to a read are the contents of the registers.
    pub parameters: &'a [u8],
}

/// Instruction of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction {
    /// Asks for an answer without contents.
    Ping,
    /// Reads consecutive registers of one servo.
    Read,
    /// Writes consecutive registers of one servo.
    Write,
    /// Reads the same registers of several servos, which answer in the order of the request.
    SyncRead,
    /// Writes the same registers of several servos, each with its own contents; no servo answers.
    SyncWrite,
}

impl Instruction {
    /// All instructions.
    pub const ALL: [Self; 5] = [Self::Ping, Self::Read, Self::Write, Self::SyncRead, Self::SyncWrite];

    /// Code of the instruction in a request.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Ping => 0x01,
            Self::Read => 0x02,
            Self::Write => 0x03,
            Self::SyncRead => 0x82,
            Self::SyncWrite => 0x83,
        }
    }

    /// Returns the instruction with this code.
    #[must_use]
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|instruction| instruction.code() == code)
    }
}

/// Computes the checksum of the bytes between header and checksum.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u8 {
    !bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte))
}
