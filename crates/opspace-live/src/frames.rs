//! Frames of WebSockets (RFC 6455), as a server reads and writes them. Bytes in, messages out: no socket is touched here.

/// Largest message of a client, bytes. Those of the page have some hundred.
pub const LARGEST_MESSAGE: usize = 64 << 10;

/// Largest number of frames of one message. Only large messages need several.
const LARGEST_FRAME_COUNT: u32 = 64;

/// Largest content of a control frame, bytes.
const LARGEST_CONTROL: usize = 125;

const CONTINUATION: u8 = 0;
const TEXT: u8 = 1;
const BINARY: u8 = 2;
const CLOSE: u8 = 8;
const PING: u8 = 9;
const PONG: u8 = 10;

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

/// Reason why a connection must be closed, with its code of RFC 6455.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadFrame {
    /// Code of the close frame.
    pub code: u16,
    /// Description.
    pub what: &'static str,
}

const fn bad(what: &'static str) -> BadFrame {
    BadFrame { code: 1002, what }
}

/// Reader of the frames of a connection. It keeps at most one message, whatever is sent.
#[derive(Debug, Default)]
pub struct FrameReader {
    bytes: Vec<u8>,
    /// Kind, content and number of frames of a message that is not complete.
    part: Option<(u8, Vec<u8>, u32)>,
}

/// Header of a frame.
struct Header {
    is_final: bool,
    opcode: u8,
    mask: [u8; 4],
    content: std::ops::Range<usize>,
}

impl FrameReader {
    /// Passes the messages that are complete with these further bytes to `receive`, until it returns false.
    ///
    /// # Errors
    /// Bytes that are no frames of a client, or a message that is too long. The connection is not usable after it.
    pub fn push(&mut self, bytes: &[u8], receive: &mut dyn FnMut(Message) -> bool) -> Result<(), BadFrame> {
        self.bytes.extend_from_slice(bytes);
        let mut begin = 0;
        while let Some(header) = header(&self.bytes[begin..])? {
            let Header { is_final, opcode, mask, content } = header;
            let Some(frame) = self.bytes[begin..].get(content.clone()) else { break };
            let content_bytes: Vec<u8> =
                frame.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask).collect();
            begin += content.end;
            if let Some(message) = self.add(is_final, opcode, content_bytes)?
                && !receive(message)
            {
                break;
            }
        }
        self.bytes.drain(..begin);
        Ok(())
    }

    /// Adds a frame, and returns the message that it completes.
    fn add(&mut self, is_final: bool, opcode: u8, content: Vec<u8>) -> Result<Option<Message>, BadFrame> {
        match opcode {
            PING => return Ok(Some(Message::Ping(content))),
            PONG => return Ok(None),
            CLOSE => return Ok(Some(Message::Close)),
            _ => {}
        }
        let (opcode, content, frames) = match (opcode, self.part.take()) {
            (CONTINUATION, None) => return Err(bad("a continuation of no message")),
            (CONTINUATION, Some((opcode, mut whole, frames))) => {
                whole.extend_from_slice(&content);
                (opcode, whole, frames + 1)
            }
            (_, Some(_)) => return Err(bad("a message within another one")),
            (_, None) => (opcode, content, 1),
        };
        if content.len() > LARGEST_MESSAGE || frames > LARGEST_FRAME_COUNT {
            return Err(BadFrame { code: 1009, what: "the message is too long" });
        }
        if !is_final {
            self.part = Some((opcode, content, frames));
            return Ok(None);
        }
        if opcode == BINARY {
            return Ok(Some(Message::Binary(content)));
        }
        let text = String::from_utf8(content);
        text.map(|text| Some(Message::Text(text)))
            .map_err(|_| BadFrame { code: 1007, what: "the text is not UTF-8" })
    }
}

/// Reads the header of a client's frame; `None` if it is not complete.
fn header(bytes: &[u8]) -> Result<Option<Header>, BadFrame> {
    let &[first, second, ..] = bytes else { return Ok(None) };
    let (is_final, opcode) = (first & 0x80 != 0, first & 0x0f);
    if first & 0x70 != 0 {
        return Err(bad("an extension that was not agreed"));
    }
    if second & 0x80 == 0 {
        return Err(bad("a client's frame without mask"));
    }
    let short = usize::from(second & 0x7f);
    let is_control = opcode & 8 != 0;
    if !matches!(opcode, CONTINUATION | TEXT | BINARY | CLOSE | PING | PONG) {
        return Err(bad("a kind of frames that does not exist"));
    }
    if is_control && (!is_final || short > LARGEST_CONTROL) {
        return Err(bad("a control frame that is long or in parts"));
    }
    let width = match short {
        126 => 2,
        127 => 8,
        _ => 0,
    };
    let Some(long) = bytes.get(2..2 + width) else { return Ok(None) };
    let length = match width {
        0 => short as u64,
        _ => long.iter().fold(0, |length, &byte| length << 8 | u64::from(byte)),
    };
    if length > LARGEST_MESSAGE as u64 {
        return Err(BadFrame { code: 1009, what: "the frame is too long" });
    }
    let begin = 2 + width + 4;
    let Some(mask) = bytes.get(2 + width..begin).and_then(|mask| mask.first_chunk()) else { return Ok(None) };
    Ok(Some(Header { is_final, opcode, mask: *mask, content: begin..begin + length as usize }))
}

/// Appends the header of a server's frame, which is not masked, with a content of `length` bytes.
fn put_header(opcode: u8, length: usize, out: &mut Vec<u8>) {
    out.push(0x80 | opcode);
    match (u8::try_from(length), u16::try_from(length)) {
        (Ok(short), _) if short < 126 => out.push(short),
        (_, Ok(length)) => {
            out.push(126);
            out.extend(length.to_be_bytes());
        }
        _ => {
            out.push(127);
            out.extend((length as u64).to_be_bytes());
        }
    }
}

/// Appends a text.
pub fn put_text(text: &str, out: &mut Vec<u8>) {
    put_header(TEXT, text.len(), out);
    out.extend_from_slice(text.as_bytes());
}

/// Appends a binary message of several parts.
pub fn put_binary(parts: &[&[u8]], out: &mut Vec<u8>) {
    put_header(BINARY, parts.iter().map(|part| part.len()).sum(), out);
    parts.iter().for_each(|part| out.extend_from_slice(part));
}

/// Appends the answer to a ping.
pub fn put_pong(content: &[u8], out: &mut Vec<u8>) {
    let content = &content[..content.len().min(LARGEST_CONTROL)];
    put_header(PONG, content.len(), out);
    out.extend_from_slice(content);
}

/// Appends the end of a connection.
pub fn put_close(code: u16, out: &mut Vec<u8>) {
    put_header(CLOSE, size_of::<u16>(), out);
    out.extend(code.to_be_bytes());
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    /// Returns a frame as a client writes it.
    fn frame(first: u8, content: &[u8]) -> Vec<u8> {
        let mask = [0x37, 0xfa, 0x21, 0x3d];
        let mut out = Vec::new();
        put_header(first & 0x0f, content.len(), &mut out);
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
        assert_eq!(reason(&[0x82, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]), 1009);
        let parts = [frame(0x02, &[0; 60_000]), frame(0x80, &[0; 10_000])].concat();
        assert_eq!(reason(&parts), 1009);
        let empty: Vec<u8> =
            std::iter::once(frame(0x02, b"")).chain((0..100).map(|_| frame(0, b""))).flatten().collect();
        assert_eq!(reason(&empty), 1009);
    }
}
