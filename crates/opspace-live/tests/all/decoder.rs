//! Properties of the reader of a client's frames and of its session: any bytes, in pieces of any length.

use opspace_live::frames::{BadFrame, FrameReader, LARGEST_MESSAGE, Message};
use opspace_live::session::{Action, Session};
use proptest::collection::vec;
use proptest::prelude::*;

/// Reads bytes that arrive in pieces; their lengths repeat.
fn read(bytes: &[u8], pieces: &[usize]) -> (Vec<Message>, Result<(), BadFrame>) {
    let (mut reader, mut messages) = (FrameReader::default(), Vec::new());
    let mut rest = bytes;
    for length in pieces.iter().cycle() {
        let (piece, next) = rest.split_at((*length).min(rest.len()));
        let end = reader.push(piece, &mut |message| {
            messages.push(message);
            true
        });
        if end.is_err() || next.is_empty() {
            return (messages, end);
        }
        rest = next;
    }
    (messages, Ok(()))
}

/// Frame of a client with this first byte, mask and content. Most contents are short.
fn frame(first: u8, mask: [u8; 4], content: &[u8]) -> Vec<u8> {
    let length = match (u8::try_from(content.len()), u16::try_from(content.len())) {
        (Ok(short), _) if short < 126 => vec![0x80 | short],
        (_, Ok(middle)) => [&[0x80 | 126][..], &middle.to_be_bytes()].concat(),
        _ => [&[0x80 | 127][..], &(content.len() as u64).to_be_bytes()].concat(),
    };
    let masked = content.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask);
    [&[first][..], &length, &mask].concat().into_iter().chain(masked).collect()
}

/// Contents that come near to what a page sends.
fn content() -> impl Strategy<Value = Vec<u8>> {
    let texts = prop::sample::select(vec![
        r#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":0}]}"#,
        r#"{"op":"advertise","channels":[{"id":1,"topic":"/hand","encoding":"json"},{"id":2,"topic":"/control","encoding":"json"}]}"#,
        r#"{"op":"unsubscribe","subscriptionIds":[1]}"#,
        "\u{1}\u{1}\0\0\0{\"frame\":\"hand\",\"point_m\":[0,0,0],\"target_m\":[0.4,0,0.3]}",
        "\u{1}\u{2}\0\0\0{\"op\":\"speed\",\"value\":0.5}",
    ]);
    let edited = (texts, any::<prop::sample::Index>(), any::<u8>()).prop_map(|(text, at, byte)| {
        let mut bytes = text.as_bytes().to_vec();
        let at = at.index(bytes.len());
        bytes[at] = byte;
        bytes
    });
    prop_oneof![
        texts_as_they_are(),
        edited,
        vec(any::<u8>(), 0..300),
        vec(any::<u8>(), LARGEST_MESSAGE - 4..LARGEST_MESSAGE + 4)
    ]
}

/// Contents that are understood.
fn texts_as_they_are() -> impl Strategy<Value = Vec<u8>> {
    let texts =
        [&br#"{"op":"unadvertise","channelIds":[1]}"#[..], br#"{"op":"subscribe","subscriptions":[]}"#];
    prop::sample::select(texts.map(<[u8]>::to_vec).to_vec())
}

/// Frames of every kind, whole or cut off.
fn frames() -> impl Strategy<Value = Vec<u8>> {
    let first = prop::sample::select(vec![0x81, 0x82, 0x01, 0x02, 0x00, 0x80, 0x88, 0x89, 0x8a, 0xc1, 0x83]);
    let one =
        (first, any::<[u8; 4]>(), content()).prop_map(|(first, mask, content)| frame(first, mask, &content));
    (vec(one, 0..6), 0..20_usize).prop_map(|(frames, cut)| {
        let mut bytes = frames.concat();
        bytes.truncate(bytes.len().saturating_sub(cut));
        bytes
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Compared: messages and end of bytes that arrive at once, and in pieces. No message is longer than what is allowed, and together they are
    /// no longer than the bytes; each has an answer of bounded length, or none.
    #[test]
    fn any_bytes_in_any_pieces_are_read_alike(
        bytes in prop_oneof![vec(any::<u8>(), 0..400), frames()],
        pieces in vec(1..5000_usize, 1..8),
    ) {
        let (messages, end) = read(&bytes, &[usize::MAX]);
        prop_assert_eq!(&read(&bytes, &pieces), &(messages.clone(), end));
        let lengths = messages.iter().map(|message| match message {
            Message::Text(text) => text.len(),
            Message::Binary(content) | Message::Ping(content) => content.len(),
            Message::Close => 0,
        });
        let lengths: Vec<usize> = lengths.collect();
        prop_assert!(lengths.iter().all(|length| *length <= LARGEST_MESSAGE));
        prop_assert!(lengths.iter().sum::<usize>() <= bytes.len());
        let mut session = Session::default();
        for action in messages.iter().flat_map(|message| session.receive(message)) {
            if let Action::Warn(what) = action {
                prop_assert!(!what.is_empty() && what.len() < 5000, "{}", what);
            }
        }
    }
}
