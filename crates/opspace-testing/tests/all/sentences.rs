//! Length of the sentences of all pages, and of a release in CHANGELOG.md: short sentences are read once.
//!
//! A sentence is the text between `.`, `!`, `?` and `:`, outside code, tables, headings and formulas. Each list item and
//! each paragraph ends one. A code span or a formula in a line counts as one word, a link as its text.

use std::fs;
use std::path::{Path, PathBuf};

/// Largest average and maximum of the words of a sentence.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Limits {
    average: f64,
    maximum: usize,
}

/// Limits of a page. The front page and the first steps are read by people who do not know the project yet.
fn limits(page: &str) -> Limits {
    match page {
        "README.md" => Limits { average: 14.0, maximum: 30 },
        page if page.starts_with("docs/start/") => Limits { average: 16.0, maximum: 40 },
        _ => Limits { average: 20.0, maximum: 45 },
    }
}

/// Pages that exceed their limits, with the words of their longest sentence: they may only become better.
const UNFINISHED: &[(&str, usize)] = &[];

/// Compared: the words of the sentences of each page, and the limits.
#[test]
fn sentences_are_short() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut pages: Vec<PathBuf> =
        ["README", "ARCHITECTURE", "DESIGN", "CONTRIBUTING", "CHANGELOG", "python/README"]
            .map(|name| root.join(name).with_extension("md"))
            .to_vec();
    for folder in ["docs", "crates"] {
        collect(&root.join(folder), &mut pages);
    }
    assert!(pages.len() > 50, "only {} pages were found", pages.len());
    let (mut all, mut long) = (0, Vec::new());
    for path in pages {
        let page = path.strip_prefix(&root).expect("below the root").display().to_string();
        let sentences = sentences(&fs::read_to_string(&path).expect("a page"));
        let words: usize = sentences.iter().map(|sentence| sentence.words).sum();
        all += sentences.len();
        let Limits { average, maximum } = limits(&page);
        let ceiling = UNFINISHED.iter().find(|(unfinished, _)| *unfinished == page);
        let maximum = ceiling.map_or(maximum, |(_, ceiling)| maximum.max(*ceiling));
        if words as f64 > average * sentences.len() as f64 {
            long.push(format!("{page}: {words} words in {} sentences", sentences.len()));
        }
        for Sentence { line, words, text } in sentences.iter().filter(|sentence| sentence.words > maximum) {
            long.push(format!("{page}:{line}: {words} words: {text}"));
        }
        let is_finished = sentences.iter().all(|sentence| sentence.words <= limits(&page).maximum);
        assert!(ceiling.is_none() || !is_finished, "{page} keeps its limits: remove it from `UNFINISHED`");
    }
    assert!(all > 1500, "only {all} sentences were found: the reader is wrong");
    assert!(long.is_empty(), "{}", long.join("\n"));
}

/// Most lines of a release in CHANGELOG.md: a user of the version before finds what he must know.
const LINES_OF_A_RELEASE: usize = 120;

/// Compared: the lines of each release, and their limit.
#[test]
fn releases_are_short() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../CHANGELOG.md");
    let page = fs::read_to_string(path).expect("a page");
    let releases: Vec<&str> = page.split("\n## ").skip(1).collect();
    assert!(releases.len() >= 2, "{} releases", releases.len());
    for release in releases {
        let (name, count) = (release.lines().next().expect("a heading"), release.trim_end().lines().count());
        assert!(count <= LINES_OF_A_RELEASE, "{name}: {count} lines");
    }
}

#[test]
fn sentences_are_read() {
    let page = "# A heading. It counts not.\n\nOne `code span with words` and [a link](file.md#x) of 3.5 m.\nTwo\nwords (5 %). \
                Three: four!\n\n* An item\n* Another item with $x + y$\n  of two lines\n\n| a | table. |\n\n```sh\ncode. code\n```\n\n\
                $$\nx = y.\n$$\n\n<img alt=\"A picture. Two.\">\n";
    let found: Vec<(usize, usize)> = sentences(page).iter().map(|s| (s.line, s.words)).collect();
    assert_eq!(found, [(3, 8), (3, 3), (3, 1), (3, 1), (7, 2), (8, 7)]);
}

/// A sentence of a page, with the line in which its paragraph begins, from 1.
#[derive(Debug)]
struct Sentence {
    line: usize,
    words: usize,
    text: String,
}

/// Returns the sentences of a page.
fn sentences(page: &str) -> Vec<Sentence> {
    paragraphs(page).iter().flat_map(|(line, text)| split(*line, &plain(text))).collect()
}

/// Paragraphs and list items of a page, each as one line, with its number.
fn paragraphs(page: &str) -> Vec<(usize, String)> {
    let mut paragraphs: Vec<(usize, String)> = Vec::new();
    let (mut is_code, mut is_formula, mut is_open) = (false, false, false);
    for (index, line) in page.lines().enumerate() {
        let line = line.trim();
        if line.starts_with("```") {
            is_code = !is_code;
            is_open = false;
        } else if !is_code && (line.starts_with("$$") || is_formula) {
            is_formula ^= line.matches("$$").count() % 2 == 1;
            is_open = false;
        } else if is_code || line.is_empty() || line.starts_with(['|', '#', '<']) {
            is_open = false;
        } else {
            let item = item(line);
            if is_open && item.is_none() {
                let (_, text) = paragraphs.last_mut().expect("an open paragraph");
                text.push(' ');
                text.push_str(line);
            } else {
                paragraphs.push((index + 1, item.unwrap_or(line).to_owned()));
                is_open = true;
            }
        }
    }
    paragraphs
}

/// Text of a list item.
fn item(line: &str) -> Option<&str> {
    let digits = line.trim_start_matches(|c: char| c.is_ascii_digit());
    let numbered = if digits.len() < line.len() { digits.strip_prefix(". ") } else { None };
    ["* ", "- ", "+ "].iter().find_map(|mark| line.strip_prefix(mark)).or(numbered)
}

/// Text without marks: a code span or a formula is one word, a link is its text, pictures and tags are left out.
fn plain(text: &str) -> String {
    let text = replaced(&replaced(text, "`", "`", |_| "CODE".to_owned()), "$", "$", |_| "FORMULA".to_owned());
    let text = replaced(&replaced(&text, "![", ")", |_| String::new()), "](", ")", |_| String::new());
    replaced(&text, "<", ">", |_| String::new()).replace('[', "")
}

/// Replaces each part of a text that begins and ends with the marks.
fn replaced(text: &str, begin: &str, end: &str, new: impl Fn(&str) -> String) -> String {
    let (mut rest, mut result) = (text, String::new());
    while let Some((before, after)) = rest.split_once(begin) {
        let Some((inside, after)) = after.split_once(end) else { break };
        result.push_str(before);
        result.push_str(&new(inside));
        rest = after;
    }
    result + rest
}

/// Splits a paragraph after each mark of the end of a sentence that is followed by a space.
fn split(line: usize, text: &str) -> Vec<Sentence> {
    let mut sentences = vec![Vec::new()];
    for word in text.split_whitespace() {
        let sentence: &mut Vec<&str> = sentences.last_mut().expect("one at least");
        sentence.push(word);
        if word.trim_end_matches(['*', '_', ')', '"', '\'']).ends_with(['.', '!', '?', ':']) {
            sentences.push(Vec::new());
        }
    }
    let count = |words: &[&str]| words.iter().filter(|word| word.contains(char::is_alphanumeric)).count();
    let sentences =
        sentences.iter().map(|words| Sentence { line, words: count(words), text: words.join(" ") });
    sentences.filter(|sentence| sentence.words > 0).collect()
}

/// Markdown pages of a folder and its subfolders, except build output.
fn collect(folder: &Path, pages: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("a file").path();
        if path.is_dir() && !path.ends_with("target") && !path.ends_with("node_modules") {
            collect(&path, pages);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            pages.push(path);
        }
    }
}
