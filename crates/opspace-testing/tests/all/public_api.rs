//! Public API of each crate, compared with the committed lists in `tests/api/`.

use public_api::Builder;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Environment variable that makes the test write the lists instead of comparing them.
const WRITE: &str = "OPSPACE_WRITE_API";
/// Folder of the lists.
const LISTS: &str = "tests/api";
/// Maximum number of differing lines in a message.
const SHOWN: usize = 20;

/// Compared: the public items of each crate according to rustdoc's JSON, without derived and automatic
/// implementations, and the committed lists. All features are enabled.
#[test]
#[ignore = "documents the whole workspace; .ci/run does"]
fn public_items_are_those_of_the_committed_lists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().expect("the project");
    let scratch = tempfile::tempdir().expect("a folder");
    let documentation = document(&root, scratch.path());
    let mut differences = Vec::new();
    for name in crates(&root) {
        let json = documentation.join(name.replace('-', "_")).with_extension("json");
        let items = public_items(&json);
        assert!(items.lines().count() > 1, "{name} has no items: the reader is wrong");
        let list = root.join(LISTS).join(&name).with_extension("txt");
        if std::env::var_os(WRITE).is_some() {
            fs::create_dir_all(root.join(LISTS)).expect("a folder");
            fs::write(&list, items).expect("a list");
        } else {
            let committed = fs::read_to_string(&list).unwrap_or_default();
            differences.extend(compared(&name, &committed, &items));
        }
    }
    assert!(differences.is_empty(), "{}\n{}", differences.join("\n"), REMEDY);
}

/// Text after the differences.
const REMEDY: &str = "If this is meant, write the lists anew and tell callers in CHANGELOG.md: \
     OPSPACE_WRITE_API=1 cargo test -p opspace-testing --test all public_api -- --ignored";

/// Returns the differing lines of two lists: `-` was removed, `+` was added.
fn compared(name: &str, committed: &str, items: &str) -> Vec<String> {
    let only = |sign: &str, these: &str, those: &str| -> Vec<String> {
        let those: std::collections::HashSet<&str> = those.lines().collect();
        these
            .lines()
            .filter(|line| !those.contains(line))
            .map(|line| format!("{name}: {sign} {line}"))
            .collect()
    };
    let mut all = only("-", committed, items);
    all.extend(only("+", items, committed));
    all.truncate(SHOWN);
    all
}

/// Names of the published crates.
fn crates(root: &Path) -> Vec<String> {
    let folders = fs::read_dir(root.join("crates")).expect("a folder");
    let mut names: Vec<String> = folders
        .map(|entry| entry.expect("a crate").file_name().into_string().expect("a name"))
        .filter(|name| name != "opspace-testing")
        .collect();
    names.sort();
    names
}

/// Documents all published crates as JSON and returns the folder of the files.
///
/// Only rustdoc gets `RUSTC_BOOTSTRAP`, with which a stable version can write JSON. If build scripts got it too, all
/// crates would be recompiled.
fn document(root: &Path, scratch: &Path) -> PathBuf {
    let rustdoc = scratch.join("rustdoc");
    fs::write(&rustdoc, "#!/bin/sh\nRUSTC_BOOTSTRAP=1 exec rustdoc \"$@\"\n").expect("a script");
    fs::set_permissions(&rustdoc, fs::Permissions::from_mode(0o755)).expect("a script to run");
    let status = Command::new(env!("CARGO"))
        .current_dir(root)
        .args([
            "doc",
            "--workspace",
            "--exclude",
            "opspace-testing",
            "--no-deps",
            "--all-features",
            "--locked",
        ])
        .env("RUSTDOC", &rustdoc)
        .env("RUSTDOCFLAGS", "-Z unstable-options --output-format json")
        .status()
        .expect("cargo");
    assert!(status.success(), "cargo doc failed");
    // Next to the folder `debug/deps`, which contains the tests.
    let test = std::env::current_exe().expect("this program");
    test.ancestors().nth(3).expect("the target folder").join("doc")
}

fn public_items(json: &Path) -> String {
    let api = Builder::from_rustdoc_json(json)
        .sorted(true)
        .omit_blanket_impls(true)
        .omit_auto_trait_impls(true)
        .omit_auto_derived_impls(true)
        .build()
        .expect("JSON of Rust 1.95's rustdoc: for another, update the crate public-api");
    api.to_string()
}

/// Compared: lists that differ by one removed and one added line.
#[test]
fn differing_items_are_shown() {
    let found = compared("a", "pub fn a::x()\npub fn a::y()\n", "pub fn a::y()\npub fn a::z()\n");
    assert_eq!(found, ["a: - pub fn a::x()", "a: + pub fn a::z()"]);
    assert!(compared("a", "pub fn a::x()\n", "pub fn a::x()\n").is_empty());
}
