//! Requests for the page, its meshes and the WebSocket, and who may make them. Bytes in, answers out: no socket is touched here.

use tungstenite::handshake::derive_accept_key;

/// Largest head of a request, bytes.
pub const LARGEST_HEAD: usize = 8 << 10;

/// Subprotocols of Foxglove, the preferred one first. They differ in nothing that is used here.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.websocket.v1", "foxglove.sdk.v1"];

/// Largest number of headers of a request.
const MOST_HEADERS: usize = 64;

/// Head of a request.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// Path, without query.
    pub path: String,
    /// Value of `token` in the query.
    pub token: Option<String>,
    /// Header `Host`.
    pub host: Option<String>,
    /// Header `Origin`.
    pub origin: Option<String>,
    /// Key of a request for a WebSocket.
    pub key: Option<String>,
    /// Subprotocols that the client offers.
    pub protocols: Vec<String>,
}

/// Refusal of a request, by its status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Status, for example 404.
    pub status: u16,
    /// Reason, as text of the answer.
    pub reason: &'static str,
}

/// Answer to a request that is not refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The page.
    Page,
    /// The mesh with this number.
    Mesh(usize),
    /// Nothing, for a picture that browsers ask for.
    Nothing,
    /// A WebSocket, with the answer to its key and the subprotocol.
    WebSocket {
        /// Value of `Sec-WebSocket-Accept`.
        accept: String,
        /// Subprotocol.
        protocol: &'static str,
    },
}

/// Access to a server: the addresses under which it is known, and its token.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Access {
    /// Hosts with port, for example `127.0.0.1:8765`.
    pub hosts: Vec<String>,
    /// Other origins whose pages the user trusts, for example `https://app.foxglove.dev`.
    pub origins: Vec<String>,
    /// Token that requests must have; a server that only this computer reaches has none.
    pub token: Option<String>,
}

const fn refusal(status: u16, reason: &'static str) -> Refusal {
    Refusal { status, reason }
}

/// Reads the head of a request; `None` if it is not complete.
///
/// # Errors
/// Bytes that are no request of this server.
pub fn parse(bytes: &[u8]) -> Result<Option<Request>, Refusal> {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut head = httparse::Request::new(&mut headers);
    let parsed = head.parse(bytes).map_err(|_| refusal(400, "not a request of HTTP"))?;
    if parsed.is_partial() {
        return if bytes.len() > LARGEST_HEAD { Err(refusal(431, "the head is too long")) } else { Ok(None) };
    }
    let (Some("GET"), Some(target)) = (head.method, head.path) else {
        return Err(refusal(405, "only GET is answered"));
    };
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let token = query.split('&').find_map(|pair| pair.strip_prefix("token=")).map(str::to_owned);
    let mut request = Request { path: path.to_owned(), token, ..Request::default() };
    let mut upgrade = (false, None, None);
    for header in head.headers.iter() {
        let value = std::str::from_utf8(header.value).map_err(|_| refusal(400, "the head is not UTF-8"))?;
        let value = value.trim();
        match header.name.to_ascii_lowercase().as_str() {
            "host" => request.host = Some(value.to_owned()),
            "origin" => request.origin = Some(value.to_owned()),
            "upgrade" => upgrade.0 = value.eq_ignore_ascii_case("websocket"),
            "sec-websocket-key" => upgrade.1 = Some(value.to_owned()),
            "sec-websocket-version" => upgrade.2 = Some(value.to_owned()),
            "sec-websocket-protocol" => {
                request.protocols.extend(value.split(',').map(|name| name.trim().to_owned()));
            }
            _ => {}
        }
    }
    match upgrade {
        (false, ..) => {}
        (true, Some(key), Some(version)) if version == "13" && !key.is_empty() => request.key = Some(key),
        (true, ..) => {
            return Err(refusal(400, "a request for a WebSocket without key, or of another version"));
        }
    }
    Ok(Some(request))
}

/// Answers a request.
///
/// # Errors
/// A request of another page, without the token, or for what is not there.
pub fn answer(request: &Request, access: &Access) -> Result<Answer, Refusal> {
    let is_known = |host: &str| access.hosts.iter().any(|known| known.eq_ignore_ascii_case(host));
    let host = request.host.as_deref().unwrap_or_default();
    // A page of another origin, or one whose name leads to this computer for an attack.
    let is_own = |origin: &str| {
        let authority = origin.strip_prefix("http://").unwrap_or_default();
        is_known(authority)
            || (access.token.is_some() && !host.is_empty() && authority.eq_ignore_ascii_case(host))
    };
    let is_trusted = |origin: &str| access.origins.iter().any(|trusted| trusted.eq_ignore_ascii_case(origin));
    if request.origin.as_deref().is_some_and(|origin| !is_own(origin) && !is_trusted(origin)) {
        return Err(refusal(403, "another origin"));
    }
    match (&access.token, &request.token) {
        (None, _) if !is_known(host) => return Err(refusal(403, "another host")),
        (Some(token), given) if !given.as_deref().is_some_and(|given| is_equal(token, given)) => {
            return Err(refusal(403, "the address lacks its token"));
        }
        _ => {}
    }
    if let Some(key) = &request.key {
        let offered = |name: &&str| request.protocols.iter().any(|offered| offered == name);
        let protocol = SUBPROTOCOLS.into_iter().find(|name| offered(name));
        let protocol = protocol.ok_or(refusal(400, "no subprotocol of Foxglove"))?;
        return Ok(Answer::WebSocket { accept: derive_accept_key(key.as_bytes()), protocol });
    }
    match request.path.as_str() {
        "/" => Ok(Answer::Page),
        "/favicon.ico" => Ok(Answer::Nothing),
        path => {
            let mesh = path.strip_prefix("/mesh/").and_then(|number| number.parse().ok());
            mesh.map(Answer::Mesh).ok_or(refusal(404, "not found"))
        }
    }
}

/// Compares a token in a time that does not depend on where it differs.
fn is_equal(token: &str, given: &str) -> bool {
    let differs = token.bytes().zip(given.bytes()).fold(0, |differs, (a, b)| differs | (a ^ b));
    token.len() == given.len() && differs == 0
}

/// Returns the head of an answer with a content.
#[must_use]
pub fn head(status: u16, media_type: &str, length: usize) -> String {
    let reason = match status {
        200 => "OK",
        204 => "No Content",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        431 => "Request Header Fields Too Large",
        _ => "Service Unavailable",
    };
    format!(
        "HTTP/1.1 {status} {reason}\r\nContent-Type: {media_type}\r\nContent-Length: {length}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Content-Security-Policy: frame-ancestors 'none'\r\n\r\n"
    )
}

/// Returns the head that begins a WebSocket.
#[must_use]
pub fn upgrade_head(accept: &str, protocol: &str) -> String {
    format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Accept: {accept}\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n"
    )
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    fn local() -> Access {
        Access { hosts: vec!["127.0.0.1:80".to_owned(), "localhost:80".to_owned()], ..Access::default() }
    }

    fn open() -> Access {
        Access { token: Some("secret".to_owned()), ..Access::default() }
    }

    fn ask(target: &str, headers: &str, access: &Access) -> Result<Answer, u16> {
        let head = format!("GET {target} HTTP/1.1\r\n{headers}\r\n");
        answer(&parse(head.as_bytes()).unwrap().unwrap(), access).map_err(|refusal| refusal.status)
    }

    const SOCKET: &str = "Upgrade: WebSocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
                          Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";

    /// Compared: the answer to the key of RFC 6455, section 1.3; pages, meshes and refusals.
    #[test]
    fn requests_of_the_page_are_answered() {
        let socket = |headers: &str| ask("/", &format!("{SOCKET}{headers}"), &local());
        let protocol = "Sec-WebSocket-Protocol: other, foxglove.sdk.v1\r\n";
        assert_eq!(
            socket(&format!("Host: 127.0.0.1:80\r\n{protocol}")),
            Ok(Answer::WebSocket {
                accept: "s3pPLMBiTxaQ9kYGzzhZRbK+xOo=".to_owned(),
                protocol: "foxglove.sdk.v1"
            })
        );
        assert_eq!(socket("Host: 127.0.0.1:80\r\n"), Err(400));
        assert_eq!(ask("/", "Host: localhost:80\r\n", &local()), Ok(Answer::Page));
        assert_eq!(ask("/mesh/3?x", "host:localhost:80\r\n", &local()), Ok(Answer::Mesh(3)));
        for target in ["/mesh/-1", "/mesh/../x", "/mesh/99999999999999999999", "/etc/passwd", "//"] {
            assert_eq!(ask(target, "Host: localhost:80\r\n", &local()), Err(404), "{target}");
        }
    }

    /// Other origins and hosts, and a wrong token, are refused.
    #[test]
    fn foreign_pages_are_refused() {
        let own = "Host: 127.0.0.1:80\r\n";
        for origin in ["http://127.0.0.1:80", "http://localhost:80", "http://LOCALHOST:80"] {
            assert_eq!(ask("/", &format!("{own}Origin: {origin}\r\n"), &local()), Ok(Answer::Page));
        }
        for origin in [
            "http://127.0.0.1:81",
            "https://127.0.0.1:80",
            "null",
            "",
            "http://evil.example",
            "http://evil:80",
        ] {
            assert_eq!(ask("/", &format!("{own}Origin: {origin}\r\n"), &local()), Err(403), "{origin}");
        }
        let viewer = "https://app.foxglove.dev";
        let trusting = Access { origins: vec![viewer.to_owned()], ..local() };
        let of_viewer = format!("{own}Origin: {viewer}\r\n");
        assert_eq!(
            (ask("/", &of_viewer, &trusting), ask("/", &of_viewer, &local())),
            (Ok(Answer::Page), Err(403))
        );
        // A name that leads to this computer: host and origin agree.
        let rebound = "Host: evil.example:80\r\nOrigin: http://evil.example:80\r\n";
        assert_eq!(ask("/", rebound, &local()), Err(403));
        assert_eq!(ask("/", "Host: evil.example:80\r\n", &local()), Err(403));
        assert_eq!(ask("/", "", &local()), Err(403));
        let there = "Host: 10.0.0.2:80\r\nOrigin: http://10.0.0.2:80\r\n";
        assert_eq!(ask("/?a=b&token=secret", there, &open()), Ok(Answer::Page));
        for target in ["/", "/?token=", "/?token=secre", "/?token=secrets", "/?token=Secret"] {
            assert_eq!(ask(target, there, &open()), Err(403), "{target}");
        }
        let foreign = "Host: 10.0.0.2:80\r\nOrigin: http://evil.example\r\n";
        assert_eq!(ask("/?token=secret", foreign, &open()), Err(403));
    }

    /// Bytes that are no request are refused; the beginning of one is awaited.
    #[test]
    fn other_bytes_are_refused() {
        let status = |text: &str| parse(text.as_bytes()).unwrap_err().status;
        assert_eq!(parse(b"GET / HTTP/1.1\r\nHost: x\r\n").unwrap(), None);
        assert_eq!(status("POST / HTTP/1.1\r\n\r\n"), 405);
        assert_eq!(status("GET /\r\n\r\n"), 400);
        assert_eq!(status("GET / HTTP/1.1\r\nno colon\r\n\r\n"), 400);
        assert_eq!(status("GET / HTTP/1.1\r\nUpgrade: websocket\r\n\r\n"), 400);
        assert_eq!(parse(&[0xff; 100_000]).unwrap_err().status, 400);
        assert_eq!(status(&format!("GET /{}", "a".repeat(100_000))), 431);
        assert_eq!(status(&format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(100))), 400);
        assert_eq!(parse(b"\xff\r\n\r\n").unwrap_err().status, 400);
    }
}
