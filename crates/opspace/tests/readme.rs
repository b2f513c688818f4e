//! The Rust program of the project's README, run from the folder to which its paths are relative.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

#[path = "../../../examples/circle.rs"]
mod circle;

/// Compared: the measured position of the tip, and the circle about the point below its start.
#[test]
fn the_tip_of_the_readme_follows_its_circle() {
    std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
    circle::main().unwrap();
}
