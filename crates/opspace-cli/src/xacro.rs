//! Expansion of a xacro file by the program `xacro` of ROS.

use crate::console::{Exit, Failure};
use opspace_model::files::find_program;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Longest time for an expansion.
const LONGEST: Duration = Duration::from_secs(20);

/// Time between two looks at the program.
const PAUSE: Duration = Duration::from_millis(10);

/// Returns the URDF that `xacro FILE` prints.
///
/// # Errors
/// If the program is missing, fails, or takes too long.
pub fn expanded(file: &Path) -> Result<String, Failure> {
    let refuse = |text: String| Failure::Other(format!("{}: {text}", file.display()), Exit::Bad);
    let by_hand = || {
        let urdf = file.with_extension("");
        let name = if urdf.extension().is_some() { urdf } else { urdf.with_extension("urdf") };
        format!("expand it where ROS is installed: xacro {} > {}", file.display(), name.display())
    };
    // A name that begins with a hyphen is no option.
    let file_argument = if file.is_relative() { Path::new(".").join(file) } else { file.to_owned() };
    let missing = || refuse(format!("the program 'xacro' was not found; {}", by_hand()));
    let started = Command::new(find_program("xacro").ok_or_else(missing)?)
        .arg(file_argument)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut child =
        started.map_err(|error| refuse(format!("the program 'xacro' was not started: {error}")))?;
    // Read meanwhile: a full pipe would stop the program.
    let (out, error) = (reader(child.stdout.take()), reader(child.stderr.take()));
    let Some(success) = wait(&mut child) else {
        return Err(refuse(format!("xacro took longer than {} s; {}", LONGEST.as_secs(), by_hand())));
    };
    let [out, error] = [out, error].map(|thread| thread.join().unwrap_or_default());
    match success {
        true => Ok(out),
        false => Err(refuse(format!("xacro failed: {}", error.trim()))),
    }
}

/// Reads all text of a pipe, in a thread.
fn reader(pipe: Option<impl Read + Send + 'static>) -> thread::JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        // What could be read before an error is enough for a message.
        pipe.map(|mut pipe| pipe.read_to_end(&mut bytes));
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

/// Returns whether the program succeeds; `None` if it had to be ended.
fn wait(child: &mut Child) -> Option<bool> {
    let begun = Instant::now();
    while begun.elapsed() < LONGEST {
        if let Ok(Some(status)) = child.try_wait() {
            return Some(status.success());
        }
        thread::sleep(PAUSE);
    }
    drop(child.kill());
    drop(child.wait());
    None
}
