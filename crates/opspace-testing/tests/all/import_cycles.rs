//! No file of a crate imports, directly or through others, a file that imports it.
//!
//! Compared: the `use crate::` and `use super::` edges between the files of each crate, without tests, and a list
//! without cycles. The dynamics files of opspace-model are excepted, because they share one `Model` and one `Data`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Crates in which cycles are allowed.
const EXCEPTED: [&str; 1] = ["opspace-model"];

/// Module path in a crate; empty for lib.rs.
type Module = Vec<String>;

#[test]
fn no_crate_has_an_import_cycle() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut cycles = Vec::new();
    let mut edges = 0;
    for entry in fs::read_dir(crates).expect("the folder of the crates") {
        let root = entry.expect("a folder").path();
        let name = root.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if EXCEPTED.contains(&name.as_str()) || !root.join("src").is_dir() {
            continue;
        }
        let imports = imports(&root.join("src"));
        edges += imports.values().map(BTreeSet::len).sum::<usize>();
        cycles.extend(cycle(&imports).map(|files| format!("{name}: {}", files.join(" -> "))));
    }
    assert!(edges > 200, "only {edges} imports were found: the reader is wrong");
    assert!(cycles.is_empty(), "import cycles:\n{}", cycles.join("\n"));
}

#[test]
fn cycle_is_found() {
    let module = |name: &str| vec![name.to_owned()];
    let edge = |from: &str, to: &str| (module(from), BTreeSet::from([module(to)]));
    let circle = BTreeMap::from([edge("a", "b"), edge("b", "c"), edge("c", "a"), edge("d", "a")]);
    assert_eq!(cycle(&circle), Some(["a", "b", "c", "a"].map(str::to_owned).to_vec()));
    let tree = BTreeMap::from([edge("a", "b"), edge("b", "c"), edge("d", "a")]);
    assert_eq!(cycle(&tree), None);
}

#[test]
fn nested_imports_are_read() {
    let text = "use crate::a::{b::C, d};\nuse super::e;\npub use f::G;\nuse std::fmt;\n#[cfg(test)]\nmod tests { use crate::z; }\n";
    let found: Vec<String> =
        paths(text, &["x".to_owned(), "y".to_owned()]).iter().map(|p| p.join("::")).collect();
    assert_eq!(found, ["a::b::C", "a::d", "x::e", "x::y::f::G"]);
}

/// Modules that each module of a crate imports.
fn imports(src: &Path) -> BTreeMap<Module, BTreeSet<Module>> {
    let mut files = BTreeMap::new();
    collect(src, &mut Vec::new(), &mut files);
    let modules: BTreeSet<Module> = files.keys().cloned().collect();
    let edges = |module: &Module, path: &PathBuf| {
        let text = fs::read_to_string(path).expect("a source file");
        let targets = paths(&text, module).into_iter().filter_map(|path| defining(&path, &modules));
        targets.filter(|target| target != module).collect()
    };
    files.iter().map(|(module, path)| (module.clone(), edges(module, path))).collect()
}

fn collect(folder: &Path, module: &mut Module, files: &mut BTreeMap<Module, PathBuf>) {
    for entry in fs::read_dir(folder).expect("a source folder") {
        let path = entry.expect("a source file").path();
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            module.push(name);
            collect(&path, module, files);
            module.pop();
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let mut own = module.clone();
            if !["lib", "main", "mod"].contains(&name.as_str()) {
                own.push(name);
            }
            files.insert(own, path);
        }
    }
}

/// Module whose file defines an item: the longest prefix of its path that is a module.
fn defining(path: &[String], modules: &BTreeSet<Module>) -> Option<Module> {
    (1..=path.len()).rev().map(|length| path[..length].to_vec()).find(|part| modules.contains(part))
}

/// Paths that a file imports from its crate, relative to the crate root.
fn paths(text: &str, module: &[String]) -> Vec<Vec<String>> {
    let code = text.split("#[cfg(test)]\nmod").next().unwrap_or_default();
    let mut found = Vec::new();
    for line in code.split(';') {
        let statement =
            line.rsplit_once("use ").map(|(before, tree)| (before.lines().last().unwrap_or(""), tree));
        let Some((before, tree)) = statement else { continue };
        let before = before.trim();
        if !(before.is_empty() || before.starts_with("pub")) {
            continue;
        }
        let mut flat = Vec::new();
        flatten(&tree.split_whitespace().collect::<String>(), &mut Vec::new(), &mut flat);
        found.extend(flat.into_iter().filter_map(|path| from_root(path, module, before.starts_with("pub"))));
    }
    found
}

/// Expands the braces of an import.
fn flatten(tree: &str, prefix: &mut Vec<String>, found: &mut Vec<Vec<String>>) {
    let Some(open) = tree.find('{') else {
        let own = tree.split("::").map(str::to_owned);
        found.push(prefix.iter().cloned().chain(own).collect());
        return;
    };
    let before: Vec<String> = tree[..open].split("::").filter(|p| !p.is_empty()).map(str::to_owned).collect();
    let length = prefix.len();
    prefix.extend(before);
    let inner = tree[open + 1..].strip_suffix('}').unwrap_or_default();
    let (mut depth, mut begin) = (0, 0);
    for (at, character) in inner.char_indices().chain([(inner.len(), ',')]) {
        match character {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if at > begin {
                    flatten(&inner[begin..at], prefix, found);
                }
                begin = at + 1;
            }
            _ => {}
        }
    }
    prefix.truncate(length);
}

/// Path of an import relative to the crate root; `None` for other crates. A re-export without `crate` refers to a
/// child module.
fn from_root(path: Vec<String>, module: &[String], exported: bool) -> Option<Vec<String>> {
    let first = path.first()?.as_str();
    let rest = path[1..].to_vec();
    match first {
        "crate" => Some(rest),
        "super" => Some([&module[..module.len().saturating_sub(1)], &rest].concat()),
        "self" => Some([module, &rest].concat()),
        _ if exported && first.starts_with(char::is_lowercase) && !first.starts_with("opspace_") => {
            Some([module, &path].concat())
        }
        _ => None,
    }
}

/// Returns a cycle, if there is one; its first module is repeated at the end.
fn cycle(imports: &BTreeMap<Module, BTreeSet<Module>>) -> Option<Vec<String>> {
    let mut done = BTreeSet::new();
    imports.keys().find_map(|module| search(module, imports, &mut Vec::new(), &mut done))
}

fn search(
    module: &Module,
    imports: &BTreeMap<Module, BTreeSet<Module>>,
    path: &mut Vec<Module>,
    done: &mut BTreeSet<Module>,
) -> Option<Vec<String>> {
    if let Some(begin) = path.iter().position(|other| other == module) {
        let names = path[begin..].iter().chain([module]).map(|module| module.join("::"));
        return Some(names.collect());
    }
    if !done.insert(module.clone()) {
        return None;
    }
    path.push(module.clone());
    let targets = imports.get(module).into_iter().flatten();
    let found = targets.filter_map(|target| search(target, imports, path, done)).next();
    path.pop();
    found
}
