//! Frames of WebSockets (RFC 6455), as a server reads and writes them: bytes in, messages out. The crate `tungstenite` reads and writes
//! them; no socket is touched here.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use tungstenite::error::CapacityError;
use tungstenite::protocol::frame::coding::{Control, Data, OpCode};
use tungstenite::protocol::frame::{CloseFrame, Frame, FrameHeader};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, WebSocket};

/// Largest message of a client, bytes. Those of the page have some hundred.
pub const LARGEST_MESSAGE: usize = 64 << 10;

/// Message of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// Text.
    Text(String),
    /// Bytes.
    Binary(Vec<u8>),
    /// Request of a pong with this content.
    Ping(Vec<u8>),
    /// End of the connection.
    Close,
}

/// Reason why a connection must be closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadFrame {
    /// Code of the close frame (RFC 6455, section 7.4).
    pub code: u16,
}

/// Reader of the frames of a connection. It keeps at most one message, whatever is sent.
#[derive(Debug)]
pub struct FrameReader(WebSocket<Received>);

/// Bytes that have been received and not read. What the socket itself would answer is dropped: the server does.
#[derive(Debug, Default)]
struct Received(VecDeque<u8>);

impl Read for Received {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.0.is_empty() { Err(ErrorKind::WouldBlock.into()) } else { self.0.read(into) }
    }
}

impl Write for Received {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Default for FrameReader {
    fn default() -> Self {
        let config = WebSocketConfig::default()
            .max_message_size(Some(LARGEST_MESSAGE))
            .max_frame_size(Some(LARGEST_MESSAGE))
            .read_buffer_size(4 << 10);
        Self(WebSocket::from_raw_socket(Received::default(), Role::Server, Some(config)))
    }
}

impl FrameReader {
    /// Passes the messages that are complete with these further bytes to `receive`, until it returns false.
    ///
    /// # Errors
    /// Bytes that are no frames of a client, or a message that is too long. The connection is not usable after it.
    pub fn push(&mut self, bytes: &[u8], receive: &mut dyn FnMut(Message) -> bool) -> Result<(), BadFrame> {
        self.0.get_mut().0.extend(bytes);
        loop {
            let message = match self.0.read() {
                Ok(tungstenite::Message::Text(text)) => Message::Text(text.as_str().to_owned()),
                Ok(tungstenite::Message::Binary(content)) => Message::Binary(content.into()),
                Ok(tungstenite::Message::Ping(content)) => Message::Ping(content.into()),
                Ok(tungstenite::Message::Close(_)) => Message::Close,
                Ok(_) => continue,
                Err(Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(Error::ConnectionClosed | Error::AlreadyClosed) => return Ok(()),
                Err(error) => return Err(BadFrame { code: code(&error) }),
            };
            if !receive(message) {
                return Ok(());
            }
        }
    }
}

/// Code of the close frame that answers an error.
fn code(error: &Error) -> u16 {
    match error {
        Error::Capacity(CapacityError::MessageTooLong { .. }) => 1009,
        Error::Utf8(_) => 1007,
        _ => 1002,
    }
}

/// Appends the header of a server's frame, which is not masked, with a content of `length` bytes.
fn put_header(opcode: OpCode, length: usize, out: &mut Vec<u8>) {
    let header = FrameHeader { opcode, ..FrameHeader::default() };
    // A vector takes all bytes.
    let _ = header.format(length as u64, out);
}

/// Appends a text.
pub fn put_text(text: &str, out: &mut Vec<u8>) {
    put_header(OpCode::Data(Data::Text), text.len(), out);
    out.extend_from_slice(text.as_bytes());
}

/// Appends a binary message of several parts.
pub fn put_binary(parts: &[&[u8]], out: &mut Vec<u8>) {
    put_header(OpCode::Data(Data::Binary), parts.iter().map(|part| part.len()).sum(), out);
    parts.iter().for_each(|part| out.extend_from_slice(part));
}

/// Appends the answer to a ping.
pub fn put_pong(content: &[u8], out: &mut Vec<u8>) {
    put_header(OpCode::Control(Control::Pong), content.len(), out);
    out.extend_from_slice(content);
}

/// Appends the end of a connection.
pub fn put_close(code: u16, out: &mut Vec<u8>) {
    let frame = Frame::close(Some(CloseFrame { code: code.into(), reason: "".into() }));
    let _ = frame.format(out);
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// Returns a frame as a client writes it.
    fn frame(first: u8, content: &[u8]) -> Vec<u8> {
        let mask = [0x37, 0xfa, 0x21, 0x3d];
        let mut out = Vec::new();
        put_binary(&[content], &mut out);
        out.truncate(out.len() - content.len());
        (out[0], out[1]) = (first, out[1] | 0x80);
        out.extend(mask);
        out.extend(content.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
        out
    }

    /// Reads bytes that arrive in pieces of a length.
    fn read(bytes: &[u8], piece: usize) -> Result<Vec<Message>, BadFrame> {
        let (mut reader, mut messages) = (FrameReader::default(), Vec::new());
        for piece in bytes.chunks(piece) {
            reader.push(piece, &mut |message| {
                messages.push(message);
                true
            })?;
        }
        Ok(messages)
    }

    /// Compared: the masked text of RFC 6455, section 5.7, and "Hello"; messages of every width of lengths, whole, in frames, and in
    /// pieces of any length, and their contents.
    #[test]
    fn messages_are_read_however_they_arrive() {
        let hello = [0x81, 0x85, 0x37, 0xfa, 0x21, 0x3d, 0x7f, 0x9f, 0x4d, 0x51, 0x58];
        assert_eq!(frame(0x81, b"Hello"), hello);
        let long = vec![7; LARGEST_MESSAGE];
        let bytes = [
            frame(0x81, b"Hello"),
            frame(0x89, b"?"),
            frame(0x02, &long[..200]),
            frame(0x89, b"between"),
            frame(0x80, &long[200..300]),
            frame(0x8a, b"ignored"),
            frame(0x82, &long),
            frame(0x88, &[3, 232]),
        ]
        .concat();
        let expected = [
            Message::Text("Hello".to_owned()),
            Message::Ping(b"?".to_vec()),
            Message::Ping(b"between".to_vec()),
            Message::Binary(long[..300].to_vec()),
            Message::Binary(long),
            Message::Close,
        ];
        for piece in [1, 2, 7, 1000, 1 << 20] {
            assert_eq!(read(&bytes, piece).unwrap(), expected);
        }
    }

    /// Frames that a client may not send are refused, before their content arrives if it is too long.
    #[test]
    fn bad_frames_are_refused() {
        let reason = |bytes: &[u8]| read(bytes, 3).unwrap_err().code;
        let plain = [0x81, 0x01, b'a'];
        assert_eq!(reason(&plain), 1002);
        assert_eq!(reason(&frame(0xc1, b"a")), 1002);
        assert_eq!(reason(&frame(0x83, b"a")), 1002);
        assert_eq!(reason(&frame(0x09, b"a")), 1002);
        assert_eq!(reason(&frame(0x89, &[0; 126])), 1002);
        assert_eq!(reason(&frame(0x80, b"a")), 1002);
        assert_eq!(reason(&[frame(0x01, b"a"), frame(0x81, b"b")].concat()), 1002);
        assert_eq!(reason(&frame(0x81, &[0xff])), 1007);
        assert_eq!(reason(&[0x82, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0]), 1009);
        let parts = [frame(0x02, &[0; 60_000]), frame(0x80, &[0; 10_000])].concat();
        assert_eq!(reason(&parts), 1009);
    }
}
