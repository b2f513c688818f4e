//! Prints the command that runs the tests of this crate: `opspace-testing` compiles them, because a package has one level of
//! optimisation.
#![expect(clippy::print_stdout, reason = "the command is what it is for")]

fn main() {
    println!(
        "the tests of {} are run by: cargo test -p opspace-testing --test mujoco",
        env!("CARGO_PKG_NAME")
    );
}
