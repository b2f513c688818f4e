//! Requests to servos, and their answers.

use crate::protocol::register::{OutOfRange, Register};
use crate::protocol::{BROADCAST_ID, Decoded, Decoder, Encoder, ErrorFlags, TooLong};
use crate::transport::Transport;
use std::io;
use std::time::Duration;

/// Largest number of bytes that are read of a servo in one request.
pub const MAX_READ: usize = 32;

/// Time within which a servo must answer a single request. An adapter for USB may collect bytes for 16 ms.
const ANSWER_WITHIN: Duration = Duration::from_millis(50);

/// Time after the last attempt in which a late answer tells a slow adapter or a busy computer from a missing servo.
const LATE_WITHIN: Duration = Duration::from_millis(500);

/// Number of times that a single request is sent before a servo counts as missing.
const ATTEMPTS: usize = 5;

/// Number of lengths of single reads, which follow one another: an answer to an earlier request has another length, and is
/// not taken for one to the present request. Answers have no number.
const LENGTHS: u8 = 4;

/// Number of times that bytes are taken after a deadline.
const SURPLUS: usize = 8;

/// Servos on a connection, one request at a time.
#[derive(Debug)]
pub struct Bus<T> {
    transport: T,
    encoder: Encoder,
    decoder: Decoder,
    /// Number of bytes that the next single read asks for beyond its register.
    surplus: u8,
}

/// Reason why a request has no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BusError {
    /// The connection is gone.
    #[error("the port is gone: {0}")]
    Port(#[from] io::Error),
    /// A servo did not answer.
    #[error("servo {id} does not answer")]
    NoAnswer {
        /// Identifier.
        id: u8,
    },
    /// A servo answered, but later than [`BusError::LATE`].
    #[error("servo {id} answers more than {} ms after a request", Self::LATE.as_millis())]
    Late {
        /// Identifier.
        id: u8,
    },
    /// Answers of a servo have wrong checksums.
    #[error("the answers of servo {id} have wrong checksums")]
    Checksum {
        /// Identifier.
        id: u8,
    },
    /// A servo sent another answer than was asked for.
    #[error("servo {id} sent another answer than was asked for")]
    WrongAnswer {
        /// Identifier of the servo that was asked.
        id: u8,
    },
    /// A request does not fit in a packet.
    #[error(transparent)]
    TooLong(#[from] TooLong),
    /// A value does not fit in its register.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
}

impl BusError {
    /// Time after which the answer to a single request is late.
    pub const LATE: Duration = ANSWER_WITHIN;
}

/// Answer of one servo to a request to several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// Outcome: an answer, a wrong one, or none.
    pub outcome: Outcome,
    /// Error flags of the answer.
    pub flags: ErrorFlags,
    /// Contents, in the first bytes.
    pub data: [u8; MAX_READ],
}

/// Outcome of a request for one of the servos that were asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing.
    Missing,
    /// An answer with a wrong checksum.
    Checksum,
    /// An answer of another length.
    WrongLength {
        /// Number of bytes of its contents.
        bytes: usize,
    },
    /// The answer.
    Complete,
}

impl Default for Answer {
    fn default() -> Self {
        Self { outcome: Outcome::Missing, flags: ErrorFlags::NONE, data: [0; MAX_READ] }
    }
}

/// Outcome of a request to several servos.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Round {
    /// Number of complete answers.
    pub complete: usize,
    /// Number of answers of servos that were not asked.
    pub foreign: usize,
    /// Number of damaged packets.
    pub damaged: usize,
    /// Number of bytes that had arrived before the request, and were discarded: of answers that came too late.
    pub discarded: usize,
}

impl<T: Transport> Bus<T> {
    /// Returns the bus on a connection.
    #[must_use]
    pub fn new(transport: T) -> Self {
        Self { transport, encoder: Encoder::default(), decoder: Decoder::new(MAX_READ), surplus: 0 }
    }

    /// Connection.
    #[must_use]
    pub fn transport(&self) -> &T {
        &self.transport
    }

    /// Connection, to be changed.
    pub fn transport_mut(&mut self) -> &mut T {
        &mut self.transport
    }

    /// Asks a servo for an answer, and returns its error flags.
    ///
    /// # Errors
    /// If it does not answer.
    pub fn ping(&mut self, id: u8) -> Result<ErrorFlags, BusError> {
        self.exchange(id, 0, |encoder| Ok(encoder.ping(id))).map(|answer| answer.flags)
    }

    /// Asks a servo for an answer, once and not longer than `within`. Returns true if it answers.
    ///
    /// # Errors
    /// If the connection is gone.
    pub fn answers(&mut self, id: u8, within: Duration) -> Result<bool, BusError> {
        let mut answers = [Answer::default()];
        self.discard()?;
        self.transport.send(self.encoder.ping(id))?;
        let deadline = self.transport.now() + within;
        Ok(self.collect(&[id], 0, deadline, &mut answers)?.complete == 1)
    }

    /// Reads a register of a servo.
    ///
    /// # Errors
    /// If the servo does not answer, or answers wrongly.
    pub fn read(&mut self, id: u8, register: Register) -> Result<i32, BusError> {
        self.surplus = (self.surplus + 1) % LENGTHS;
        let length = register.width + self.surplus;
        let answer =
            self.exchange(id, usize::from(length), |encoder| Ok(encoder.read(id, register.address, length)))?;
        register.decode(&answer.data).ok_or(BusError::WrongAnswer { id })
    }

    /// Writes a register of a servo.
    ///
    /// # Errors
    /// If the servo does not answer, or the register cannot contain the value.
    pub fn write(&mut self, id: u8, register: Register, value: i32) -> Result<(), BusError> {
        let bytes = register.encode(value)?;
        let data = &bytes[..usize::from(register.width)];
        self.exchange(id, 0, |encoder| encoder.write(id, register.address, data)).map(|_| ())
    }

    /// Reads the same bytes of several servos; their answers are in the order of `ids`. Returns at the deadline at the latest.
    /// Bytes that have arrived before are discarded. Allocates nothing.
    ///
    /// # Errors
    /// If the connection is gone. An answer that is missing or wrong is an [`Outcome`].
    pub fn sync_read(
        &mut self,
        ids: &[u8],
        address: u8,
        length: usize,
        deadline: Duration,
        answers: &mut [Answer],
    ) -> Result<Round, BusError> {
        let discarded = self.discard()?;
        let bytes = u8::try_from(length).map_err(|_| TooLong)?;
        self.transport.send(self.encoder.sync_read(address, bytes, ids)?)?;
        Ok(Round { discarded, ..self.collect(ids, length, deadline, answers)? })
    }

    /// Writes two bytes of each of several servos. No servo answers. Allocates nothing.
    ///
    /// # Errors
    /// If the connection is gone.
    pub fn sync_write(
        &mut self,
        address: u8,
        values: impl ExactSizeIterator<Item = (u8, [u8; 2])>,
    ) -> Result<(), BusError> {
        Ok(self.transport.send(self.encoder.sync_write(address, values)?)?)
    }

    /// Sends a request to one servo until it answers, five times at most.
    fn exchange(
        &mut self,
        id: u8,
        length: usize,
        encode: impl Fn(&mut Encoder) -> Result<&[u8], TooLong>,
    ) -> Result<Answer, BusError> {
        let mut answers = [Answer::default()];
        let mut failure = BusError::NoAnswer { id };
        for attempt in 0..ATTEMPTS {
            self.discard()?;
            self.transport.send(encode(&mut self.encoder)?)?;
            let deadline = self.transport.now() + ANSWER_WITHIN;
            let round = self.collect(&[id], length, deadline, &mut answers)?;
            match answers[0].outcome {
                Outcome::Complete => {
                    if attempt > 0 {
                        // The answers to the other attempts may still come.
                        self.transport.wait_until(deadline);
                    }
                    return Ok(answers[0]);
                }
                Outcome::Checksum => failure = BusError::Checksum { id },
                Outcome::Missing if round.damaged > 0 => failure = BusError::Checksum { id },
                Outcome::WrongLength { .. } => failure = BusError::WrongAnswer { id },
                Outcome::Missing if round.foreign > 0 => failure = BusError::WrongAnswer { id },
                Outcome::Missing => {}
            }
        }
        if matches!(failure, BusError::NoAnswer { .. }) {
            // Of any length, since it may be the answer to any of the attempts.
            let deadline = self.transport.now() + LATE_WITHIN;
            self.collect(&[id], length, deadline, &mut answers)?;
            if answers[0].outcome != Outcome::Missing {
                failure = BusError::Late { id };
            }
        }
        Err(failure)
    }

    /// Discards what has arrived, such as a late answer to the request before, and returns its number of bytes.
    fn discard(&mut self) -> Result<usize, BusError> {
        let (mut buffer, mut discarded) = ([0; 256], 0);
        // Bounded, since another program may send without end.
        for _ in 0..16 {
            match self.transport.receive(&mut buffer, Duration::ZERO)? {
                0 => break,
                received => discarded += received,
            }
        }
        self.decoder.clear();
        Ok(discarded)
    }

    /// Receives answers with `length` bytes until all are there, or until the deadline.
    fn collect(
        &mut self,
        ids: &[u8],
        length: usize,
        deadline: Duration,
        answers: &mut [Answer],
    ) -> Result<Round, BusError> {
        answers.fill(Answer::default());
        let mut round = Round::default();
        let (mut buffer, mut surplus) = ([0; 256], 0);
        while round.complete < ids.len() {
            let received = self.transport.receive(&mut buffer, deadline)?;
            surplus += usize::from(self.transport.now() >= deadline);
            // What has arrived in time is taken even if the program is late, but not what a bus sends without end.
            if received == 0 || surplus > SURPLUS {
                // What follows a damaged length has been held back.
                while self.decoder.give_up() {
                    sort(&mut self.decoder, ids, length, answers, &mut round);
                }
                break;
            }
            let mut rest = &buffer[..received];
            while !rest.is_empty() {
                let taken = self.decoder.push(rest);
                rest = &rest[taken..];
                sort(&mut self.decoder, ids, length, answers, &mut round);
            }
        }
        Ok(round)
    }
}

/// Sorts the packets that have arrived by the servos that were asked.
fn sort(decoder: &mut Decoder, ids: &[u8], length: usize, answers: &mut [Answer], round: &mut Round) {
    while let Some(decoded) = decoder.next_packet() {
        let (id, packet) = match decoded {
            Decoded::Packet(packet) => (packet.id, Some(packet)),
            Decoded::Damaged { id } => (id, None),
        };
        round.damaged += usize::from(packet.is_none());
        // An adapter may echo the request.
        if id == BROADCAST_ID {
            continue;
        }
        let asked = ids.iter().position(|other| *other == id);
        let Some(answer) = asked.and_then(|index| answers.get_mut(index)) else {
            round.foreign += usize::from(packet.is_some());
            continue;
        };
        if answer.outcome == Outcome::Complete {
            continue;
        }
        match packet {
            None => answer.outcome = Outcome::Checksum,
            Some(packet) if packet.parameters.len() != length => {
                answer.outcome = Outcome::WrongLength { bytes: packet.parameters.len() };
            }
            Some(packet) => {
                answer.outcome = Outcome::Complete;
                answer.flags = ErrorFlags::from_bits(packet.code);
                // The decoder passes at most as many.
                answer.data[..length].copy_from_slice(packet.parameters);
                round.complete += 1;
            }
        }
    }
}
