//! Names that were replaced by standard terms of the field: none may be in use.

use std::fs;
use std::path::{Path, PathBuf};

/// Committed list of old names; its header describes the format.
const LIST: &str = include_str!("old-names.txt");

/// Files that may contain old names: the list, the table of renamed keys, the changelog.
const EXEMPT: [&str; 4] = ["old-names.txt", "old_names.rs", "renamed.rs", "CHANGELOG.md"];

/// Folders of build output and results.
const OUTPUT: [&str; 6] = ["target", "runs", "book", ".git", "logs", "node_modules"];

/// Compared: all definitions, file names, keys and words of the project, and the list of old names.
#[test]
fn no_old_name_is_in_use() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut files = Vec::new();
    collect(&root, &mut files);
    let files: Vec<(String, String)> = files
        .iter()
        .filter_map(|path| {
            let name = path.strip_prefix(&root).expect("below the root").display().to_string();
            Some((name, fs::read_to_string(path).ok()?))
        })
        .collect();
    assert!(files.len() > 400, "only {} files were read", files.len());
    let small: Vec<(String, String)> =
        files.iter().map(|(file, text)| (file.clone(), text.to_lowercase())).collect();
    let found: Vec<String> = LIST
        .lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .flat_map(|line| {
            let (kind, rest) = line.split_once(' ').expect("a kind and its words");
            uses(kind, rest, &files, &small).into_iter().map(move |place| format!("{place}: {line}"))
        })
        .collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Lists the places in the files where the name in a line of the list is in use. `small` are the files in small letters.
fn uses(kind: &str, rest: &str, files: &[(String, String)], small: &[(String, String)]) -> Vec<String> {
    if kind == "text" {
        return lines(small, rest, |_, line| has_words(line, rest));
    }
    let (place, name) = rest.split_once(' ').expect("a place and a name");
    match kind {
        "name" => {
            let is_in = |file: &str| file.starts_with(place) && file.ends_with(".rs");
            lines(files, name, |file, line| is_in(file) && defines(line, name))
        }
        "file" => {
            let is_one = |file: &str| file.starts_with(place) && file.rsplit('/').next() == Some(name);
            files.iter().filter(|(file, _)| is_one(file)).map(|(file, _)| file.clone()).collect()
        }
        "key" => files
            .iter()
            .filter(|(file, text)| file.ends_with(".toml") && text.contains(name))
            .filter(|(_, text)| {
                let table: toml::Table = text.parse().expect("a TOML file");
                has_key(&table, &mut Vec::new(), place, name)
            })
            .map(|(file, _)| file.clone())
            .collect(),
        _ => panic!("'{kind}' is no kind of line"),
    }
}

/// True if a text contains the words, and not only as parts of longer words.
fn has_words(text: &str, words: &str) -> bool {
    let is_letter = |c: char| c.is_alphanumeric() || c == '_';
    text.match_indices(words).any(|(at, _)| {
        let (before, after) = (text[..at].chars().next_back(), text[at + words.len()..].chars().next());
        !before.is_some_and(is_letter) && !after.is_some_and(is_letter)
    })
}

/// Lists the lines that contain `name` and for which `is_found` is true, as `file:line`.
fn lines(files: &[(String, String)], name: &str, is_found: impl Fn(&str, &str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for (file, text) in files.iter().filter(|(_, text)| text.contains(name)) {
        let numbered = text.lines().enumerate();
        found.extend(
            numbered.filter(|(_, line)| is_found(file, line)).map(|(n, _)| format!("{file}:{}", n + 1)),
        );
    }
    found
}

/// True if a line of Rust defines an item, a field or a variant of the given name.
fn defines(line: &str, name: &str) -> bool {
    let line = line.trim_start();
    if line.starts_with("//") || line.starts_with('#') || line.starts_with('"') {
        return false;
    }
    let mut words = line.split(|c: char| !(c.is_alphanumeric() || c == '_')).filter(|word| !word.is_empty());
    const ITEMS: [&str; 8] = ["fn", "struct", "enum", "trait", "type", "const", "static", "mod"];
    let Some(at) = words.position(|word| word == name) else { return false };
    let before: Vec<&str> = line
        .split(|c: char| !(c.is_alphanumeric() || c == '_'))
        .filter(|word| !word.is_empty())
        .take(at)
        .collect();
    if before.last().is_some_and(|word| ITEMS.contains(word)) {
        return true;
    }
    // A public field, or a variant on a separate line.
    let rest =
        line.trim_start_matches("pub ").trim_start_matches("pub(crate) ").trim_start_matches("pub(super) ");
    let Some(after) = rest.strip_prefix(name) else { return false };
    let is_field = rest.len() < line.len() && after.starts_with(": ");
    let is_variant = name.starts_with(char::is_uppercase) && (after == "," || after.starts_with(" {\n"));
    is_field || is_variant
}

/// True if a table whose path ends with `place` has the key.
fn has_key(table: &toml::Table, path: &mut Vec<String>, place: &str, name: &str) -> bool {
    let ends: Vec<&str> = place.split('.').collect();
    let is_there = place == "*"
        || path.len() >= ends.len()
            && path[path.len() - ends.len()..]
                .iter()
                .zip(&ends)
                .all(|(part, end)| *end == "*" || part == end);
    if is_there && table.contains_key(name) {
        return true;
    }
    table.iter().any(|(key, value)| {
        path.push(key.clone());
        let tables = match value {
            toml::Value::Array(elements) => elements.iter().filter_map(toml::Value::as_table).collect(),
            other => other.as_table().into_iter().collect::<Vec<_>>(),
        };
        let found = tables.into_iter().any(|table| has_key(table, path, place, name));
        path.pop();
        found
    })
}

/// Compared: lines that define a name and lines that only use it, classified manually.
#[test]
fn definitions_and_keys_are_read() {
    for line in
        ["pub fn told(&self)", "    pub told: f64,", "struct told;", "mod told;", "pub const told: u8 = 1;"]
    {
        assert!(defines(line, "told"), "{line}");
    }
    for line in ["let told = 1;", "// fn told", "told(x)", "fn told_more()", "self.told: x"] {
        assert!(!defines(line, "told"), "{line}");
    }
    assert!(defines("    Told,", "Told") && !defines("    Told(x) => 1,", "Told"));
    let table: toml::Table =
        "[[run]]\nvariant = [{ set = [] }]\n[profile.a.x]\nratio = 1".parse().expect("TOML");
    let has = |place: &str, key: &str| has_key(&table, &mut Vec::new(), place, key);
    assert!(
        has("variant", "set")
            && has("run.variant", "set")
            && has("*", "ratio")
            && has("profile.*.x", "ratio")
    );
    assert!(!has("run", "set") && !has("profile.*", "ratio"));
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of the project") {
        let path = entry.expect("a file of the project").path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if path.is_dir() {
            if !OUTPUT.contains(&name.as_str()) {
                collect(&path, files);
            }
        } else if !EXEMPT.contains(&name.as_str())
            && [".rs", ".toml", ".md", ".html", ".js", "run"].iter().any(|end| name.ends_with(end))
        {
            files.push(path);
        }
    }
}
