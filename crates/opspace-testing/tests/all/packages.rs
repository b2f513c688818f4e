//! Copies of project files in the folders of the crates, which are needed in their packages.

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Compares two files byte by byte.
fn assert_equal(copy: &Path, original: &Path) {
    let read = |path: &Path| fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert!(read(copy) == read(original), "{} differs from {}", copy.display(), original.display());
}

/// Files of a folder and its subfolders.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("a file").path();
        if path.is_dir() { all.extend(files(&path)) } else { all.push(path) }
    }
    all
}

/// Compared: the files that crates embed, and the original files of the project.
#[test]
fn embedded_files_are_those_of_the_project() {
    for (name, least) in [("opspace-experiment", 7), ("opspace-setup", 3)] {
        let embedded = root().join("crates").join(name).join("embedded");
        let copies = files(&embedded);
        assert!(copies.len() >= least, "{copies:?}");
        for copy in copies {
            assert_equal(&copy, &root().join(copy.strip_prefix(&embedded).expect("within the folder")));
        }
    }
}

/// Compared: the URDF in the documentation of `opspace-model`, and that of the project.
#[test]
fn robot_of_the_documentation_is_that_of_the_project() {
    assert_equal(&root().join("crates/opspace-model/urdf/ur5e.urdf"), &root().join("robots/ur5e/ur5e.urdf"));
}

/// Compared: the licences of each crate, and those of the project.
#[test]
fn licences_of_the_crates_are_those_of_the_project() {
    let mut crates = 0;
    let folders = fs::read_dir(root().join("crates")).expect("a folder");
    let folders = folders.map(|entry| entry.expect("a crate").path());
    for folder in folders.chain(["python", "ros2"].map(|folder| root().join(folder))) {
        if folder.ends_with("opspace-testing") {
            continue;
        }
        crates += 1;
        for licence in ["LICENSE-MIT", "LICENSE-APACHE"] {
            assert_equal(&folder.join(licence), &root().join(licence));
        }
    }
    assert!(crates >= 11, "only {crates} crates");
}
