//! Folders of runs in a view that are killed, or restarted by a page: nothing that was recorded is lost.

#![expect(clippy::unwrap_used, reason = "tests")]

use crate::cli_common::{opspace, project, scratch};
use crate::live_view::Program;
use opspace_log::Recording;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// Bytes of a log in which some tenths of a second are recorded.
const BEGUN_BYTES: u64 = 100_000;

/// Client of a view: a page that shows nothing.
struct Client(TcpStream);

impl Client {
    /// Connects, by which the run begins, and announces the channel of the controls.
    fn connect(program: &Program) -> Self {
        let host = program.page.trim_start_matches("http://").trim_end_matches('/');
        let mut stream = TcpStream::connect(host).unwrap();
        let request = format!(
            "GET / HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = [0; 12];
        stream.read_exact(&mut answer).unwrap();
        assert_eq!(&answer, b"HTTP/1.1 101");
        let mut client = Self(stream);
        client.send(0x81, br#"{"op":"advertise","channels":[{"id":1,"topic":"/control","encoding":"json","schemaName":""}]}"#);
        client
    }

    /// Sends a frame of less than 126 bytes, with a mask of zeros.
    fn send(&mut self, first: u8, content: &[u8]) {
        let length = u8::try_from(content.len()).ok().filter(|length| *length < 126).unwrap();
        let bytes = [&[first, 0x80 | length, 0, 0, 0, 0], content].concat();
        self.0.write_all(&bytes).unwrap();
    }

    fn restart(&mut self) {
        self.send(0x82, &[&[1, 1, 0, 0, 0], &br#"{"op":"restart"}"#[..]].concat());
    }
}

#[track_caller]
fn wait_for(what: &str, is_done: impl Fn() -> bool) {
    let begin = Instant::now();
    while !is_done() {
        assert!(begin.elapsed() < Duration::from_secs(60), "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn wait_for_log(log: &Path) {
    wait_for("a log", || fs::metadata(log).is_ok_and(|log| log.len() > BEGUN_BYTES));
}

/// Runs of one robot and of two side by side are killed. The next run moves their folder aside as it is; a folder that the user names is
/// refused. What was recorded is replayed, and simulated again.
#[test]
fn killed_run_is_moved_aside_whole() {
    for (robots, logs) in
        [(&[][..], &["run.mcap"][..]), (&["--beside", "torque"], &["position/run.mcap", "torque/run.mcap"])]
    {
        let folder = scratch();
        let task = project("tasks/compliant-x.toml");
        let run = |more: &[&str]| {
            [&["run", &task], robots, more].concat().into_iter().map(str::to_owned).collect::<Vec<_>>()
        };
        let long = run(&["--view=0", "--duration-s", "60"]);
        let mut program = Program::start(folder.path(), &long.iter().map(String::as_str).collect::<Vec<_>>());
        let _page = Client::connect(&program);
        let runs = folder.path().join("runs");
        wait_for("a folder", || fs::read_dir(&runs).is_ok_and(|runs| runs.count() == 1));
        let first = fs::read_dir(&runs).unwrap().next().unwrap().unwrap().path();
        logs.iter().for_each(|log| wait_for_log(&first.join(log)));
        program.kill();
        let recorded: Vec<Vec<u8>> = logs.iter().map(|log| fs::read(first.join(log)).unwrap()).collect();
        let named = first.display().to_string();
        let start = |more: &[&str]| {
            let arguments = run(more);
            opspace(folder.path(), &arguments.iter().map(String::as_str).collect::<Vec<_>>())
        };
        // Only a view shows robots side by side.
        if robots.is_empty() {
            start(&["--duration-s", "2", "--out", &named]).exits(2).says(&["already contains a run"]);
            start(&["--duration-s", "2"]).exits(0).says(&["moved the previous run"]);
        } else {
            let again = run(&["--view=0", "--duration-s", "60"]);
            let program =
                Program::start(folder.path(), &again.iter().map(String::as_str).collect::<Vec<_>>());
            program.interrupt();
        }
        let aside = first.with_file_name(format!("{}.previous", first.file_name().unwrap().display()));
        for (log, bytes) in logs.iter().zip(&recorded) {
            assert!(fs::read(aside.join(log)).unwrap() == *bytes, "{log} is as it was");
            let rows = Recording::from_bytes(bytes).unwrap().channel("tick").unwrap().len();
            assert!(rows > 20, "{rows} cycles are read");
            let log = aside.join(log).display().to_string();
            // All that is readable is equal; the exit code says that the file is damaged.
            for how in [&["replay", &log][..], &["replay", "--simulate", &log]] {
                opspace(folder.path(), how)
                    .exits(3)
                    .prints(&["bit for bit"])
                    .says(&["the file is truncated"]);
            }
        }
        opspace(folder.path(), &["report", &aside.display().to_string()]).exits(3);
    }
}

/// A page restarts a run twice, in the folder that the user named: each run has a folder of its own with log, summary and page.
#[test]
fn restarted_runs_are_kept() {
    let folder = scratch();
    let task = project("tasks/compliant-x.toml");
    let program = Program::start(
        folder.path(),
        &["run", &task, "--view=0", "--duration-s", "60", "--out", "out", "--force"],
    );
    let mut page = Client::connect(&program);
    let at = |name: &str| folder.path().join(name);
    for aside in ["out.previous", "out.previous-2"] {
        wait_for_log(&at("out/run.mcap"));
        page.restart();
        wait_for(aside, || at(aside).exists());
    }
    wait_for_log(&at("out/run.mcap"));
    program.interrupt();
    for name in ["out.previous", "out.previous-2", "out"] {
        for file in ["run.mcap", "summary.json", "report.html"] {
            assert!(at(name).join(file).is_file(), "{name}/{file}");
        }
        opspace(folder.path(), &["replay", name]).exits(0);
    }
}
