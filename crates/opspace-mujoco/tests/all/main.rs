//! Tests with the MuJoCo library. Without it, they say so and pass, unless OPSPACE_MUJOCO names one.

#![expect(clippy::print_stdout, reason = "figures of agreement, and that a test is skipped")]

mod common;
mod dynamics;
mod plant;
mod runs;
mod scenes;
mod stability;
#[path = "../../../opspace-sim/tests/all/common/stiff_arms.rs"]
mod stiff_arms;
