//! Licences of all compiled crates.

use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// Allowed licence expressions, one per line; `#` begins a comment.
const ALLOWED: &str = include_str!("../../licences.txt");

/// Compared: the licences declared by all crates that are compiled on this platform, and the committed list.
#[test]
fn every_crate_has_an_allowed_licence() {
    let allowed: BTreeSet<&str> =
        ALLOWED.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')).collect();
    let metadata = metadata();
    let packages = metadata["packages"].as_array().expect("a list");
    assert!(packages.len() > 50, "only {} crates", packages.len());
    let refused: Vec<String> = packages
        .iter()
        .filter(|package| !package["license"].as_str().is_some_and(|licence| allowed.contains(licence)))
        .map(|package| format!("{} {}: {}", package["name"], package["version"], package["license"]))
        .collect();
    assert!(refused.is_empty(), "licences that licences.txt does not list:\n{}", refused.join("\n"));
}

/// Metadata of the workspace and its dependencies on this platform, read without network access.
fn metadata() -> Value {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.toml");
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--locked", "--offline", "--format-version", "1", "--filter-platform", &host()])
        .arg("--manifest-path")
        .arg(manifest)
        .output()
        .expect("cargo");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Platform on which the tests run, as named by rustc.
fn host() -> String {
    let output = Command::new(env!("CARGO")).arg("--version").arg("--verbose").output().expect("cargo");
    let text = String::from_utf8(output.stdout).expect("text");
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    host.expect("a line with the host").to_owned()
}
