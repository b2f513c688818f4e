//! Server of a view: one port for the page, its meshes and the WebSocket, with two threads for each connection.

use crate::frames::{FrameReader, put_binary, put_close, put_pong, put_text};
use crate::http::{self, Access, Answer, LARGEST_HEAD, Refusal, answer, head, upgrade_head};
use crate::hub::Hub;
use crate::protocol::{self, message_header};
use crate::queue::{Entry, Queue};
use crate::requests::{ControlMessage, HandMessage};
use crate::session::{Action, Session};
use std::io::{self, Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Page of the view, one document.
const PAGE: &[u8] = include_bytes!("page/view.html");

/// Largest number of connections at a time. A view has one page, and perhaps a second one or a viewer.
const MOST_CONNECTIONS: usize = 32;

/// Time within which the head of a request must arrive.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);

/// Time within which a part of an answer must be taken.
const WRITE_TIMEOUT: Duration = Duration::from_secs(5);

/// Longest sleep of a thread that has nothing to send.
const IDLE: Duration = Duration::from_secs(1);

/// Code of a connection that the server ends.
const GOING_AWAY: u16 = 1001;

/// Receiver of what pages ask for. Its calls come from the threads of the connections, and must not block.
pub trait Inputs: Send + Sync {
    /// Moves the hand of a connection.
    ///
    /// # Errors
    /// A request that cannot be met, with a description.
    fn hand(&self, connection: u64, message: HandMessage) -> Result<(), String>;

    /// Changes speed, gains and so on.
    ///
    /// # Errors
    /// A request that cannot be met, with a description.
    fn control(&self, message: ControlMessage) -> Result<(), String>;

    /// Called when a connection begins.
    fn connected(&self) {}

    /// Called at once when a connection is lost.
    fn lost(&self, connection: u64);
}

/// Address and access of a server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Address on which it listens.
    pub socket: SocketAddr,
    /// Token of its pages, unless only this computer reaches it.
    pub token: Option<String>,
    /// Other origins whose pages may connect.
    pub origins: Vec<String>,
}

impl Address {
    /// Address of the page, for a browser on this computer.
    #[must_use]
    pub fn page(&self) -> String {
        let host = if self.socket.ip().is_unspecified() {
            SocketAddr::new(IpAddr::from([127, 0, 0, 1]), self.socket.port())
        } else {
            self.socket
        };
        let token = self.token.as_ref().map_or_else(String::new, |token| format!("?token={token}"));
        format!("http://{host}/{token}")
    }

    fn access(&self) -> Access {
        let port = self.socket.port();
        let mut hosts =
            vec![format!("127.0.0.1:{port}"), format!("localhost:{port}"), format!("[::1]:{port}")];
        hosts.push(self.socket.to_string());
        Access { hosts, origins: self.origins.clone(), token: self.token.clone() }
    }
}

/// Server whose threads run until the program ends.
#[derive(Debug)]
pub struct Server {
    address: Address,
}

/// Data that the threads of all connections share.
struct Shared {
    hub: Arc<Hub>,
    meshes: Arc<Mutex<Vec<PathBuf>>>,
    inputs: Arc<dyn Inputs>,
    access: Access,
    name: String,
    session: String,
    connections: AtomicUsize,
    next: AtomicU64,
}

impl Server {
    /// Begins to listen on an address; pages of these other origins may connect too. An address that other computers reach gets a token. `meshes` are the files that the page may ask
    /// for, by number.
    ///
    /// # Errors
    /// An address that is taken or not of this computer.
    pub fn start(
        (socket, origins): (SocketAddr, &[String]),
        name: &str,
        hub: Arc<Hub>,
        meshes: Arc<Mutex<Vec<PathBuf>>>,
        inputs: Arc<dyn Inputs>,
    ) -> io::Result<Self> {
        let listener = TcpListener::bind(socket)?;
        let socket = listener.local_addr()?;
        let token = if socket.ip().is_loopback() { None } else { Some(random_text()?) };
        let address = Address { socket, token, origins: origins.to_vec() };
        let shared = Arc::new(Shared {
            hub,
            meshes,
            inputs,
            access: address.access(),
            name: name.to_owned(),
            session: random_text()?,
            connections: AtomicUsize::new(0),
            next: AtomicU64::new(0),
        });
        thread::Builder::new().name("opspace-view".to_owned()).spawn(move || accept(&listener, &shared))?;
        Ok(Self { address })
    }

    /// Address of the server.
    #[must_use]
    pub fn address(&self) -> &Address {
        &self.address
    }
}

/// Returns 128 random bits as text.
fn random_text() -> io::Result<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for stream in listener.incoming() {
        let Ok(stream) = stream else {
            // Too many open files, for example: they may be fewer later.
            thread::sleep(Duration::from_millis(50));
            continue;
        };
        if shared.connections.fetch_add(1, Ordering::AcqRel) >= MOST_CONNECTIONS {
            shared.connections.fetch_sub(1, Ordering::AcqRel);
            continue;
        }
        let own = Arc::clone(shared);
        let serve = move || {
            // A connection that fails is over; nothing else depends on it.
            let _ = serve(&stream, &own);
            let _ = stream.shutdown(Shutdown::Both);
            own.connections.fetch_sub(1, Ordering::AcqRel);
        };
        if thread::Builder::new().name("opspace-page".to_owned()).spawn(serve).is_err() {
            shared.connections.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

/// Answers the request of a connection.
fn serve(stream: &TcpStream, shared: &Arc<Shared>) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
    let mut bytes = Vec::new();
    let answered = match read_head(stream, &mut bytes)? {
        Ok(request) => answer(&request, &shared.access),
        Err(refusal) => Err(refusal),
    };
    let text = "text/plain; charset=utf-8";
    match answered {
        Ok(Answer::Page) => send(stream, (200, "text/html; charset=utf-8"), PAGE),
        Ok(Answer::Nothing) => send(stream, (204, text), b""),
        Ok(Answer::Mesh(number)) => {
            let file = lock(&shared.meshes).get(number).cloned();
            match file.map(std::fs::read) {
                Some(Ok(content)) => send(stream, (200, "application/octet-stream"), &content),
                _ => send(stream, (404, text), b"not found\n"),
            }
        }
        Ok(Answer::WebSocket { accept, protocol }) => {
            let mut writer = stream;
            writer.write_all(upgrade_head(&accept, protocol).as_bytes())?;
            talk(stream, shared)
        }
        Err(Refusal { status, reason }) => send(stream, (status, text), format!("{reason}\n").as_bytes()),
    }
}

/// Reads the head of a request.
fn read_head(mut stream: &TcpStream, bytes: &mut Vec<u8>) -> io::Result<Result<http::Request, Refusal>> {
    let begin = Instant::now();
    let mut part = [0; 1024];
    loop {
        match http::parse(bytes) {
            Ok(Some(request)) => return Ok(Ok(request)),
            Ok(None) => {}
            Err(refusal) => return Ok(Err(refusal)),
        }
        let left = HEAD_TIMEOUT.checked_sub(begin.elapsed()).filter(|left| !left.is_zero());
        stream.set_read_timeout(Some(left.ok_or(io::ErrorKind::TimedOut)?))?;
        let count = stream.read(&mut part[..LARGEST_HEAD.min(1024)])?;
        if count == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        bytes.extend_from_slice(&part[..count]);
    }
}

fn send(mut stream: &TcpStream, (status, media_type): (u16, &str), content: &[u8]) -> io::Result<()> {
    stream.write_all(head(status, media_type, content.len()).as_bytes())?;
    stream.write_all(content)?;
    stream.shutdown(Shutdown::Write)
}

/// Connection of a page in the hub, until it is dropped. The hand is released first.
struct Registered<'a> {
    shared: &'a Shared,
    number: u64,
}

impl Drop for Registered<'_> {
    fn drop(&mut self) {
        self.shared.inputs.lost(self.number);
        self.shared.hub.disconnect(self.number);
    }
}

/// Exchanges messages with a page until either ends.
fn talk(stream: &TcpStream, shared: &Arc<Shared>) -> io::Result<()> {
    stream.set_read_timeout(None)?;
    let number = shared.next.fetch_add(1, Ordering::Relaxed);
    let queue = shared.hub.connect(number, protocol::server_info(&shared.name, &shared.session));
    let registered = Registered { shared, number };
    shared.inputs.connected();
    let (sender, entries) = (stream.try_clone()?, Arc::clone(&queue));
    let send = move || {
        let _ = send_entries(&sender, &entries);
        let _ = sender.shutdown(Shutdown::Both);
    };
    let sending = thread::Builder::new().name("opspace-page-out".to_owned()).spawn(send)?;
    let received = receive(stream, &registered, &queue);
    drop(registered);
    let _ = stream.shutdown(Shutdown::Both);
    let _ = sending.join();
    received
}

/// Reads messages until the page is lost or must be closed.
fn receive(mut stream: &TcpStream, registered: &Registered<'_>, queue: &Queue) -> io::Result<()> {
    let Registered { shared, number } = *registered;
    let (mut reader, mut session) = (FrameReader::default(), Session::default());
    let mut bytes = [0; 16 << 10];
    loop {
        let count = stream.read(&mut bytes)?;
        if count == 0 {
            return Ok(());
        }
        let mut is_open = true;
        let read = reader.push(&bytes[..count], &mut |message| {
            for action in session.receive(&message) {
                is_open &= act(action, shared, number, queue);
            }
            is_open
        });
        let code = match read {
            Ok(()) if is_open => continue,
            Ok(()) => GOING_AWAY,
            Err(bad) => bad.code,
        };
        let mut frame = Vec::new();
        put_close(code, &mut frame);
        queue.push(Entry::Frames(frame));
        // Time for the close frame to be sent; what the page sends meanwhile is not read.
        thread::sleep(Duration::from_millis(20));
        return Ok(());
    }
}

/// Does what a message asks for; returns false if the connection ends.
fn act(action: Action, shared: &Shared, number: u64, queue: &Queue) -> bool {
    let result = match action {
        Action::Subscribe { subscription, channel } => shared.hub.subscribe(number, subscription, channel),
        Action::Unsubscribe { subscription } => {
            shared.hub.unsubscribe(number, subscription);
            Ok(())
        }
        Action::Hand(message) => shared.inputs.hand(number, message),
        Action::Control(message) => shared.inputs.control(message),
        Action::Warn(what) => Err(what),
        Action::Pong(content) => {
            let mut frame = Vec::new();
            put_pong(&content, &mut frame);
            queue.push(Entry::Frames(frame));
            Ok(())
        }
        Action::Close => return false,
    };
    if let Err(what) = result {
        queue.push(Entry::Warning(protocol::warning(&what)));
    }
    true
}

/// Sends entries of a queue until it is closed, or the page takes none any more.
fn send_entries(mut stream: &TcpStream, queue: &Queue) -> io::Result<()> {
    let mut out = Vec::new();
    while let Some(entries) = queue.take(IDLE) {
        for entry in entries {
            match entry {
                Entry::Message { subscription, log_time_ns, content } => {
                    put_binary(&[&message_header(subscription, log_time_ns), &content], &mut out);
                }
                Entry::Text(text) => put_text(&text, &mut out),
                Entry::Warning(text) => put_text(&text, &mut out),
                Entry::Frames(frames) => out.extend_from_slice(&frames),
                Entry::Time(ns) => put_binary(&[&protocol::time(ns)], &mut out),
            }
            stream.write_all(&out)?;
            out.clear();
        }
    }
    Ok(())
}

fn lock<T>(value: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}
