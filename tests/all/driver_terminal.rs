//! `opspace driver read` on a terminal: a pseudo-terminal whose screen the test draws.
#![expect(clippy::unwrap_used, reason = "a test")]

use crate::drivers::{serve, so101_at_a_link};
use opspace_feetech::protocol::Register;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcgetattr, tcsetwinsize};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// Longest time until a text is on the screen, and until the program ends.
const PATIENCE: Duration = Duration::from_secs(8);

/// Width of the screen.
const COLUMNS: u16 = 120;

/// Terminal with a screen: what a person sees.
struct Terminal {
    controller: OwnedFd,
    port: OwnedFd,
    bytes: Vec<u8>,
}

impl Terminal {
    fn open() -> Self {
        let controller = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&controller).unwrap();
        unlockpt(&controller).unwrap();
        let name = ptsname(&controller, Vec::new()).unwrap();
        let port =
            rustix::fs::open(&name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty()).unwrap();
        let size = Winsize { ws_row: 24, ws_col: COLUMNS, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&port, size).unwrap();
        Self { controller, port, bytes: Vec::new() }
    }

    /// Starts the program in a session of its own, whose terminal this is, so that Ctrl-C reaches it.
    fn start(&self, folder: &Path, arguments: &[&str]) -> Child {
        let port = || self.port.try_clone().unwrap();
        Command::new("setsid")
            .arg("--ctty")
            .arg(env!("CARGO_BIN_EXE_opspace"))
            .args(arguments)
            .current_dir(folder)
            .env("TERM", "xterm")
            .stdin(port())
            .stdout(port())
            .stderr(port())
            .spawn()
            .unwrap()
    }

    fn press(&self, key: u8) {
        rustix::io::write(&self.controller, &[key]).unwrap();
    }

    /// Takes what the program has printed, and waits for it for 20 ms at most.
    fn take(&mut self) {
        let wait = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };
        let mut files = [PollFd::new(&self.controller, PollFlags::IN)];
        if poll(&mut files, Some(&wait)).unwrap_or(0) > 0 {
            let mut buffer = [0; 4096];
            if let Ok(count) = rustix::io::read(&self.controller, &mut buffer) {
                self.bytes.extend_from_slice(&buffer[..count]);
            }
        }
    }

    /// Takes what is printed until the screen is as asked for. Returns false if the program has ended before.
    fn shows(&mut self, program: &mut Child, is_shown: impl Fn(&[String]) -> bool) -> bool {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            self.take();
            if is_shown(&self.screen()) {
                return true;
            }
            if program.try_wait().unwrap().is_some() {
                return false;
            }
        }
        panic!("{:#?}", self.screen());
    }

    /// Draws the lines of the screen, from the control sequences that a terminal knows.
    fn screen(&self) -> Vec<String> {
        let text = String::from_utf8_lossy(&self.bytes).into_owned();
        let (mut rows, mut row, mut column) = (vec![Vec::new()], 0_usize, 0_usize);
        let mut characters = text.chars().peekable();
        while let Some(character) = characters.next() {
            match character {
                '\r' => column = 0,
                '\n' => row += 1,
                '\x1b' => {
                    characters.next_if_eq(&'[');
                    let mut number = String::new();
                    let end = loop {
                        match characters.next() {
                            Some(digit) if digit.is_ascii_digit() || ";?".contains(digit) => {
                                number.push(digit)
                            }
                            end => break end.unwrap_or(' '),
                        }
                    };
                    let count = number.parse().unwrap_or(1).max(1);
                    match end {
                        'A' => row = row.saturating_sub(count),
                        'B' => row += count,
                        'G' => column = count - 1,
                        // All of the line, or what follows.
                        'K' if number == "2" => rows[row].clear(),
                        'K' => rows[row].truncate(column),
                        'J' => {
                            rows[row].truncate(column);
                            rows.truncate(row + 1);
                        }
                        'm' | 'h' | 'l' => {}
                        other => panic!("unknown control sequence {number}{other}"),
                    }
                }
                printed => {
                    // A full line continues below.
                    if column == usize::from(COLUMNS) {
                        (row, column) = (row + 1, 0);
                        rows.resize(rows.len().max(row + 1), Vec::new());
                    }
                    let line: &mut Vec<char> = &mut rows[row];
                    line.resize(line.len().max(column + 1), ' ');
                    line[column] = printed;
                    column += 1;
                }
            }
            while rows.len() <= row {
                rows.push(Vec::new());
            }
        }
        rows.into_iter().map(|line| line.into_iter().collect()).collect()
    }
}

/// The counts of a joint change while a person looks: the table changes in place, so that each joint is on the screen once. Ctrl-C
/// ends the program, the last table stays, and the terminal is as before.
#[test]
fn read_changes_its_table_in_place_until_ctrl_c() {
    let folder = so101_at_a_link();
    let bus = serve(&folder, "hold-and-yield.toml");
    let is_shown = |text: &'static str| move |lines: &[String]| lines.iter().any(|line| line.contains(text));
    // A busy machine may keep the simulated servos silent at the start.
    let (mut terminal, mut program, before) = (0..10)
        .find_map(|_| {
            let mut terminal = Terminal::open();
            let before = tcgetattr(&terminal.port).unwrap();
            let mut program = terminal.start(folder.path(), &["driver", "read", "robot.toml"]);
            terminal.shows(&mut program, is_shown("torque on")).then_some((terminal, program, before))
        })
        .unwrap();
    for counts in ["1111", "1222", "1333"] {
        // The simulated arm is held until a goal comes: its registers are as the test sets them.
        let value = counts.parse().unwrap();
        bus.bus().servo_mut(3).unwrap().set(Register::PRESENT_POSITION, value);
        assert!(terminal.shows(&mut program, is_shown(counts)), "{:#?}", terminal.screen());
    }
    terminal.press(0x03);
    let begun = Instant::now();
    let status = loop {
        terminal.take();
        match program.try_wait().unwrap() {
            Some(status) => break status,
            None => assert!(begun.elapsed() < PATIENCE, "{:#?}", terminal.screen()),
        }
    };
    (0..5).for_each(|_| terminal.take());
    let screen = terminal.screen();
    assert!(status.success(), "{status}: {screen:#?}");
    for joint in
        ["shoulder_pan ", "shoulder_lift ", "elbow_flex ", "wrist_flex ", "wrist_roll ", " °C, torque on"]
    {
        assert_eq!(screen.iter().filter(|line| line.contains(joint)).count(), 1, "{joint}: {screen:#?}");
    }
    let last = screen.iter().find(|line| line.contains("elbow_flex ")).unwrap();
    assert!(last.contains("1333 counts"), "{screen:#?}");
    assert!(screen.iter().any(|line| line.contains("Ctrl-C ends")), "{screen:#?}");
    let after = tcgetattr(&terminal.port).unwrap();
    assert_eq!(format!("{before:?}"), format!("{after:?}"));
    let text = String::from_utf8_lossy(&terminal.bytes);
    assert_eq!(text.matches("\x1b[?25l").count(), text.matches("\x1b[?25h").count());
}
