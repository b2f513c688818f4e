//! Opens a page in the browser of the user, with the opener of the platform.

use crate::console::Console;
use opspace_model::files::find_program;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Time after which an opener that has not failed is taken to be the browser itself, which runs on.
const WAIT: Duration = Duration::from_secs(2);

/// Opens a page; says where it is if there is no browser to open it.
pub fn open(page: &Path, console: Console) {
    // A browser may have another working directory.
    let path = page.canonicalize().unwrap_or_else(|_| page.to_owned());
    let (name, arguments) = opener();
    let started = find_program(name).map(|program| {
        let mut command = Command::new(program);
        command.args(arguments).arg(&path);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()
    });
    let failure = match started {
        None => Some(format!("'{name}' was not found")),
        Some(Err(error)) => Some(format!("'{name}' was not started: {error}")),
        Some(Ok(child)) => {
            ended(child).filter(|status| !status.success()).map(|_| format!("'{name}' failed"))
        }
    };
    match failure {
        None => console.note(&format!("opened {}", page.display())),
        Some(failure) => {
            console.note(&format!("no browser was opened ({failure}): open {} in one", path.display()));
        }
    }
}

/// Program that opens a file with the user's application for it, and its first arguments.
fn opener() -> (&'static str, &'static [&'static str]) {
    if cfg!(target_os = "macos") {
        ("open", &[])
    } else if cfg!(windows) {
        // The empty argument is the title of the window.
        ("cmd", &["/C", "start", ""])
    } else {
        ("xdg-open", &[])
    }
}

/// Status of a program that ends soon; `None` if it runs on.
fn ended(mut child: Child) -> Option<ExitStatus> {
    let begin = Instant::now();
    while begin.elapsed() < WAIT {
        if let Ok(Some(status)) = child.try_wait() {
            return Some(status);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    None
}
