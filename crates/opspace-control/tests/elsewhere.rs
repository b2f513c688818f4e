//! Prints the command that runs the unit tests of this crate: `opspace-testing` compiles them, because a package has one level of
//! optimisation.
#![expect(clippy::print_stdout, reason = "the command is what it is for")]

fn main() {
    println!(
        "the unit tests of {} are run by: cargo test -p opspace-testing --test control-units",
        env!("CARGO_PKG_NAME")
    );
}
