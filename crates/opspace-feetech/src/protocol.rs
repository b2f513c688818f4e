//! Feetech's protocol for the series STS and SMS, without input and output: bytes in, packets out.
//!
//! Requests and answers have one form: `FF FF id length code parameters… checksum`. The length counts the code, the
//! parameters and the checksum; the checksum is the complement of the sum of all bytes from the identifier on. The code
//! of a request is its instruction, that of an answer has the [`ErrorFlags`]. Numbers of two bytes begin with the low one.

pub mod decoder;
pub mod encoder;
pub mod error_flags;
pub mod packet;
pub mod register;

pub use decoder::{Decoded, Decoder};
pub use encoder::{Encoder, TooLong};
pub use error_flags::ErrorFlags;
pub use packet::{BROADCAST_ID, Instruction, MAX_ID, MAX_PACKET, Packet};
pub use register::{Access, REGISTERS, Register};
