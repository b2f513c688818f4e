//! Files are opened, and programs started, by the functions of `opspace_model::files`, which refuse what is no file and do
//! not look into the working folder.

use std::fs;
use std::path::{Path, PathBuf};

/// Calls that open a file for reading.
const OPENINGS: [&str; 4] = ["File::open(", "fs::read(", "fs::read_to_string(", "OpenOptions::new("];

/// Files with such calls, and the reason.
const ALLOWED: [(&str, &str); 4] = [
    ("opspace-model/src/files.rs", "the functions themselves"),
    ("opspace-experiment/src/run/result_files.rs", "it locks a folder, for which the folder is opened"),
    (
        "opspace-feetech/src/arm_config.rs",
        "a driver depends on opspace-backend alone; it checks the file itself",
    ),
    ("opspace-feetech/src/serial_port.rs", "it reads the system's list of locks, whose path is fixed"),
];

/// Compared: the calls in the sources of all crates that users run, and the list.
#[test]
fn files_are_opened_by_one_function() {
    let mut found = Vec::new();
    for (name, code) in sources() {
        let is_allowed = ALLOWED.iter().any(|(allowed, _)| name.ends_with(allowed));
        if !is_allowed && OPENINGS.iter().any(|call| calls(&code, call)) {
            found.push(format!("{name}: use opspace_model::files::open_file or read_file"));
        }
        let starts =
            code.lines().any(|line| line.starts_with("use std::process::") && line.contains("Command"));
        if starts && !code.contains("find_program") {
            found.push(format!("{name}: use opspace_model::files::find_program"));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// True if the code has a call; that of another type, such as `LogFile::open`, is none.
fn calls(code: &str, call: &str) -> bool {
    code.match_indices(call).any(|(at, _)| !code[..at].ends_with(|before: char| before.is_alphanumeric()))
}

/// Names and code of all source files, without their unit tests.
fn sources() -> Vec<(String, String)> {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut files = Vec::new();
    for entry in fs::read_dir(crates).expect("the crates") {
        let path = entry.expect("a crate").path();
        if !path.ends_with("opspace-testing") {
            collect(&path.join("src"), &mut files);
        }
    }
    assert!(files.len() > 300, "only {} files were found", files.len());
    let read = |path: PathBuf| {
        let text = fs::read_to_string(&path).expect("a source file");
        let code = text.split("#[cfg(test)]").next().unwrap_or_default().to_owned();
        (path.display().to_string(), code)
    };
    files.into_iter().map(read).collect()
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let path = entry.expect("a source file").path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}
