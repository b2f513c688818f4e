//! Stability of the simulation for random combinations of inertias, gears, friction, brakes, end stops and steps.

use crate::common::stiff_arms::{largest_energy_ratio, random_arm};
use opspace_sim::SimulatedArm;

/// Share of the draws that gain energy today: light links whose friction, stops and gears all change within one step.
const WRONG_SHARE: f64 = 0.005;

/// Share of the draws that may be refused: gears with backlash that are too stiff for the rate.
const REFUSED_SHARE: f64 = 0.05;

/// Draws an arm for each seed, and checks that it has no more energy than its motors and its weight can give it.
fn check(seeds: std::ops::Range<u64>) {
    let (mut refused, count) = (0_u32, (seeds.end - seeds.start) as f64);
    let mut wrong = Vec::new();
    for seed in seeds {
        let config = random_arm(seed);
        let Ok(mut arm) = SimulatedArm::new(config.clone()) else {
            refused += 1;
            continue;
        };
        match largest_energy_ratio(&config, &mut arm) {
            Ok(ratio) if ratio < 1.5 => {}
            result => wrong.push((seed, result)),
        }
    }
    let is_right = wrong.len() as f64 <= WRONG_SHARE * count && f64::from(refused) <= REFUSED_SHARE * count;
    assert!(is_right, "{} of {count} wrong, {refused} refused: {wrong:?}", wrong.len());
}

#[test]
fn no_arm_gains_energy() {
    check(0..300);
}

/// Ten thousand draws.
#[test]
#[ignore = "long: .ci/run"]
fn ten_thousand_arms_gain_no_energy() {
    check(0..10_000);
}
