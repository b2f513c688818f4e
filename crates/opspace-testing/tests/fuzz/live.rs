//! Bytes that reach a live view from the network: requests and frames.

use crate::edits::{apply, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use opspace_live::frames::{FrameReader, LARGEST_MESSAGE};
use opspace_live::http::{Access, answer, parse};
use opspace_live::requests::HandMessage;
use opspace_live::session::{Action, Session};

/// Most memory for the bytes of one connection, bytes.
const MOST_BYTES: usize = 8 << 20;

/// Conversation of a page: frames of texts, of messages on its channels, and of a ping.
fn conversation() -> Vec<u8> {
    let subscribe = br#"{"op":"subscribe","subscriptions":[{"id":1,"channelId":0},{"id":2,"channelId":1}]}"#;
    let advertise =
        br#"{"op":"advertise","channels":[{"id":1,"topic":"/hand","encoding":"json","schemaName":""},
        {"id":2,"topic":"/control","encoding":"json","schemaName":""}]}"#;
    let data = |channel: u8, content: &[u8]| [&[1, channel, 0, 0, 0][..], content].concat();
    let hold = br#"{"frame":"hand","point_m":[0,0,0.1],"target_m":[0.4,0,0.3],"stiffness_n_per_m":300}"#;
    let gains =
        br#"{"op":"gains","task":"hand","axis":"x","natural_frequency_rad_per_s":10,"damping_ratio":1}"#;
    [
        frame(0x81, subscribe),
        frame(0x81, advertise),
        frame(0x82, &data(1, hold)),
        frame(0x02, &data(2, br#"{"op":"#)),
        frame(0x89, b"ping"),
        frame(0x80, br#""pause"}"#),
        frame(0x82, &data(2, gains)),
        frame(0x82, &data(1, br#"{"release":true}"#)),
        frame(0x81, br#"{"op":"unsubscribe","subscriptionIds":[1]}"#),
        frame(0x88, &[3, 232]),
    ]
    .concat()
}

/// Frame of a client, without a mask that changes bits, so that edits meet the text.
fn frame(first: u8, content: &[u8]) -> Vec<u8> {
    let length = match u8::try_from(content.len()) {
        Ok(length) if length < 126 => vec![0x80 | length],
        _ => [&[0x80 | 126][..], &(content.len() as u16).to_be_bytes()].concat(),
    };
    [&[first][..], &length, &[0; 4], content].concat()
}

/// Frames are read the same whether they arrive at once or byte by byte, and what is kept of them is bounded; a session answers each
/// message, and a force that it accepts is finite.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn live_frames() {
    let seeds = [conversation()];
    let target = Target::new("live-frames", MOST_BYTES);
    for_each_input(edited(seeds.len()), 2000, |(seed, edits)| {
        let bytes = apply(&seeds, *seed, edits);
        target.check(&bytes, edits.is_empty(), || {
            let read = |piece: usize| {
                let (mut reader, mut messages) = (FrameReader::default(), Vec::new());
                let end = bytes.chunks(piece).try_for_each(|part| {
                    reader.push(part, &mut |message| {
                        messages.push(message);
                        true
                    })
                });
                (messages, end)
            };
            let (messages, end) = read(usize::MAX);
            assert_eq!(read(1), (messages.clone(), end));
            let mut session = Session::default();
            let actions: Vec<Action> = messages.iter().flat_map(|message| session.receive(message)).collect();
            actions.iter().for_each(check_action);
            end.is_ok() && !actions.iter().any(|action| matches!(action, Action::Warn(_)))
        });
    });
}

fn check_action(action: &Action) {
    match action {
        Action::Hand(HandMessage::Hold(grasp)) => {
            let numbers = grasp.point_m.iter().chain(&grasp.target_m);
            assert!(numbers.chain([&grasp.largest_force_n]).all(|value| value.is_finite()));
            assert!(
                grasp.stiffness_n_per_m >= 0.0 && grasp.damping_ns_per_m >= 0.0 && !grasp.frame.is_empty()
            );
        }
        Action::Warn(what) => assert!(!what.is_empty() && what.len() < 1000),
        Action::Pong(content) => assert!(content.len() <= LARGEST_MESSAGE),
        _ => {}
    }
}

/// A request is read as soon as its head is complete, whatever follows; one of another origin or without token is not answered.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn live_requests() {
    let page =
        b"GET /mesh/3?token=secret HTTP/1.1\r\nHost: 127.0.0.1:8765\r\nOrigin: http://127.0.0.1:8765\r\n\r\n";
    let socket = b"GET /?token=secret HTTP/1.1\r\nHost: 127.0.0.1:8765\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
                   Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
                   Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n";
    let seeds = [page.to_vec(), socket.to_vec()];
    let access = Access {
        hosts: vec!["127.0.0.1:8765".to_owned()],
        token: Some("secret".to_owned()),
        ..Access::default()
    };
    let target = Target::new("live-requests", MOST_BYTES);
    for_each_input(edited(seeds.len()), 2000, |(seed, edits)| {
        let bytes = apply(&seeds, *seed, edits);
        target.check(&bytes, edits.is_empty(), || {
            let Ok(Some(request)) = parse(&bytes) else { return false };
            assert_eq!(parse(&[&bytes[..], b"more"].concat()), Ok(Some(request.clone())));
            let answered = answer(&request, &access);
            if answered.is_ok() {
                assert_eq!(request.token.as_deref(), Some("secret"));
                let host = request.host.clone().unwrap_or_default();
                let own = [Some("http://127.0.0.1:8765".to_owned()), Some(format!("http://{host}")), None];
                assert!(own.iter().any(|own| own.as_ref().map(|own| own.to_ascii_lowercase())
                    == request.origin.as_ref().map(|origin| origin.to_ascii_lowercase())));
            }
            answered.is_ok()
        });
    });
}
