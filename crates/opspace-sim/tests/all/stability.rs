//! Stability of the simulation for random combinations of inertias, gears, friction, brakes, end stops and steps.

use crate::common::stiff_arms::{FORMER_MISTAKES, wrong_draws};
use opspace_sim::SimulatedArm;

fn check(seeds: impl IntoIterator<Item = u64>) {
    let wrong = wrong_draws(seeds, SimulatedArm::new);
    assert!(wrong.is_empty(), "{} wrong: {wrong:?}", wrong.len());
}

#[test]
fn no_arm_gains_energy() {
    check(0..300);
}

#[test]
fn no_arm_of_former_mistakes_gains_energy() {
    check(FORMER_MISTAKES);
}

/// Ten thousand draws.
#[test]
#[ignore = "long: .ci/run"]
fn ten_thousand_arms_gain_no_energy() {
    let arms = std::env::var("OPSPACE_ARMS").map_or(10_000, |arms| arms.parse().expect("a number"));
    check(0..arms);
}
