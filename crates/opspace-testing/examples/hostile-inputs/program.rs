//! The built program in a process of its own, with limits of time and memory.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Longest duration of one command: many times that of the slowest one, because other programs may run.
pub const LONGEST: Duration = Duration::from_secs(60);

/// Most addresses of one command, kB.
pub const MOST_KILOBYTES: u32 = 1_500_000;

/// Exit codes of docs/reference/exit-codes.md.
const CODES: [i32; 5] = [0, 1, 2, 3, 130];

/// The program, by its path.
pub struct Program(PathBuf);

/// End of a command.
#[derive(Debug)]
pub struct Ended {
    pub code: i32,
    /// Standard output and standard error.
    pub said: String,
}

impl Program {
    pub fn new(path: PathBuf) -> Self {
        Self(path)
    }

    /// Returns a command in a folder, behind a shell command such as `ulimit -n 9`.
    pub fn command(&self, folder: &Path, before: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", &format!("ulimit -v {MOST_KILOBYTES}; {before}exec \"$@\""), "sh"]);
        command.arg(&self.0).args(arguments).current_dir(folder).stdin(Stdio::null());
        command
    }

    /// Runs the program in a folder.
    ///
    /// # Errors
    /// Something that no input may cause, in words.
    pub fn run(&self, folder: &Path, arguments: &[&str]) -> Result<Ended, String> {
        end(self.command(folder, "", arguments), folder, &arguments.join(" "))
    }

    /// Runs the program, and returns `None` if it takes longer than a time.
    ///
    /// # Errors
    /// Something that no input may cause, in words.
    pub fn run_within(
        &self,
        folder: &Path,
        arguments: &[&str],
        longest: Duration,
    ) -> Result<Option<Ended>, String> {
        end_within(self.command(folder, "", arguments), folder, &arguments.join(" "), longest)
    }
}

/// Waits for the end of a command, named `what`, and judges it.
pub fn end(command: Command, folder: &Path, what: &str) -> Result<Ended, String> {
    let ended = end_within(command, folder, what, LONGEST)?;
    ended.ok_or_else(|| format!("{what}: no end after {LONGEST:?}"))
}

fn end_within(
    mut command: Command,
    folder: &Path,
    what: &str,
    longest: Duration,
) -> Result<Option<Ended>, String> {
    let explain = |error: std::io::Error| format!("{what}: {error}");
    let path = folder.join("said");
    let file = File::create(&path).map_err(explain)?;
    command.stdout(file.try_clone().map_err(explain)?).stderr(file);
    let mut child = command.spawn().map_err(explain)?;
    let Some(code) = wait(&mut child, longest).map_err(explain)? else { return Ok(None) };
    let said = String::from_utf8_lossy(&fs::read(&path).map_err(explain)?).into_owned();
    judge(code, said, what).map(Some)
}

/// Waits for a process; one that does not end in time is killed. The code is `None` within if a signal ended it.
pub fn wait(child: &mut Child, longest: Duration) -> std::io::Result<Option<Option<i32>>> {
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status.code()));
        }
        if begun.elapsed() > longest {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        sleep(Duration::from_millis(3));
    }
}

/// Judges code and words of a command.
fn judge(code: Option<i32>, said: String, what: &str) -> Result<Ended, String> {
    let Some(code) = code else { return Err(format!("{what}: ended by a signal: {}", tail(&said))) };
    if said.contains("panicked at") {
        return Err(format!("{what}: a panic: {}", tail(&said)));
    }
    if !CODES.contains(&code) {
        return Err(format!("{what}: exit code {code}: {}", tail(&said)));
    }
    if code == 2 && !said.contains("error") {
        return Err(format!("{what}: refused without a reason: {}", tail(&said)));
    }
    Ok(Ended { code, said })
}

/// Last lines of a text.
pub fn tail(text: &str) -> String {
    let lines: Vec<&str> = text.trim_end().lines().collect();
    lines[lines.len().saturating_sub(12)..].join("\n    ")
}
