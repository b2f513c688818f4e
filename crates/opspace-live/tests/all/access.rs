//! Who may see a view: other origins, and pages without its token, are refused.

use crate::client::{ask, upgrade};
use opspace_live::{LiveView, ViewKind};
use std::io::Read;
use std::net::SocketAddr;

fn status(address: SocketAddr, request: &str) -> u16 {
    ask(address, request).1.split(' ').nth(1).unwrap().parse().unwrap()
}

/// The page, which has less than 1 MB, its own WebSocket and refusals of a view that only this computer reaches.
#[test]
fn other_origins_are_refused() {
    let view = LiveView::start("127.0.0.1:0".parse().unwrap(), "test", ViewKind::Run).unwrap();
    let address = view.address().socket;
    let port = address.port();
    assert_eq!(view.address().page(), format!("http://127.0.0.1:{port}/"));
    let (mut stream, head) = ask(address, &format!("GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n"));
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    assert!(head.starts_with("HTTP/1.1 200") && page.contains("<title>"), "{head}");
    assert!(page.len() < 1_000_000, "{} bytes", page.len());
    let socket = |origin: &str| status(address, &upgrade(address, "/", &format!("Origin: {origin}\r\n")));
    assert_eq!(socket(&format!("http://127.0.0.1:{port}")), 101);
    assert_eq!(socket(&format!("http://localhost:{port}")), 101);
    for origin in ["http://evil.example", "null", "http://127.0.0.1", "https://app.foxglove.dev"] {
        assert_eq!(socket(origin), 403, "{origin}");
    }
    assert_eq!(status(address, "GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n"), 403);
    let get = |path: &str| status(address, &format!("GET {path} HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n"));
    assert_eq!(get("/mesh/0"), 404);
    assert_eq!(get("/../../etc/passwd"), 404);
    assert_eq!(status(address, "POST / HTTP/1.1\r\n\r\n"), 405);
}

/// A view that other computers reach has a token, without which nothing is answered.
#[test]
fn reachable_view_has_a_token() {
    let view = LiveView::start("0.0.0.0:0".parse().unwrap(), "test", ViewKind::Run).unwrap();
    let port = view.address().socket.port();
    let address = SocketAddr::from(([127, 0, 0, 1], port));
    let token = view.address().token.clone().unwrap();
    assert!(token.len() == 32 && view.address().page().ends_with(&format!("/?token={token}")));
    let get = |target: &str| status(address, &format!("GET {target} HTTP/1.1\r\nHost: {address}\r\n\r\n"));
    assert_eq!((get("/"), get("/?token=0"), get(&format!("/?token={token}"))), (403, 403, 200));
    assert_eq!(status(address, &upgrade(address, "/", "")), 403);
    assert_eq!(status(address, &upgrade(address, &format!("/?token={token}"), "")), 101);
    let other = LiveView::start("0.0.0.0:0".parse().unwrap(), "test", ViewKind::Run).unwrap();
    assert_ne!(other.address().token, Some(token));
}
