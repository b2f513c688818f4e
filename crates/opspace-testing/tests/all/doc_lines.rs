//! First lines of doc blocks: editors show them without the rest, so they must be noun phrases or begin with a verb.

use std::fs;
use std::path::{Path, PathBuf};

/// First words of clauses that are not understandable without context.
const CLAUSES: [&str; 6] = ["Of", "What", "Whether", "How", "Where", "The same"];

/// Compared: the first line of each doc block of the crates, tests, benches and examples, and the first words of
/// clauses.
#[test]
fn no_doc_block_begins_with_a_clause() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut files = Vec::new();
    for folder in ["crates", "python", "ros2", "tests", "benches", "examples"] {
        collect(&root.join(folder), &mut files);
    }
    let (mut blocks, mut clauses) = (0, Vec::new());
    for file in &files {
        let text = fs::read_to_string(file).expect("a source file");
        for (line, first) in first_lines(&text) {
            blocks += 1;
            if is_clause(first) {
                clauses.push(format!("{}:{line}: {first}", file.display()));
            }
        }
    }
    assert!(blocks > 5000, "only {blocks} doc blocks were found: the reader is wrong");
    assert!(clauses.is_empty(), "{}", clauses.join("\n"));
}

#[test]
fn first_lines_are_read() {
    let text = "//! Of a file.\n//! More.\n\n    /// A field, m.\n    /// What else.\n    x: f64,\n// How a comment begins\n";
    let found: Vec<(usize, &str)> = first_lines(text).collect();
    assert_eq!(found, [(1, "Of a file."), (4, "A field, m.")]);
    assert!(is_clause("Of a file.") && is_clause("The same, larger.") && !is_clause("Offset, m."));
}

/// Rust files of a folder and its subfolders, except build output.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a source folder") {
        let path = entry.expect("a source file").path();
        if path.is_dir() && !path.ends_with("target") {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

/// Line number (from 1) and text of the first line of each doc block.
fn first_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let doc = |line: &'_ str| -> Option<usize> {
        let trimmed = line.trim_start();
        let is_doc = trimmed.starts_with("///") || trimmed.starts_with("//!");
        is_doc.then_some(line.len() - trimmed.len() + 3)
    };
    let mut before = false;
    text.lines().enumerate().filter_map(move |(index, line)| {
        let at = doc(line);
        let is_first = at.is_some() && !before;
        before = at.is_some();
        at.filter(|_| is_first).map(|at| (index + 1, line[at..].trim()))
    })
}

fn is_clause(first: &str) -> bool {
    CLAUSES.iter().any(|clause| {
        first.strip_prefix(clause).is_some_and(|rest| !rest.starts_with(|c: char| c.is_alphanumeric()))
    })
}
