//! Stability of the drives of opspace with MuJoCo as the plant, for the random arms of opspace's own plant.

use crate::common::mujoco;
use crate::stiff_arms::{FORMER_MISTAKES, wrong_draws};
use opspace_sim::SimulatedArm;

fn check(seeds: impl IntoIterator<Item = u64>) {
    let Some(mujoco) = mujoco(None) else { return };
    let wrong = wrong_draws(seeds, |config| SimulatedArm::on_engine(config, &mujoco));
    assert!(wrong.is_empty(), "{} wrong: {wrong:?}", wrong.len());
}

#[test]
fn no_arm_gains_energy() {
    check((0..100).chain(FORMER_MISTAKES));
}

/// Ten thousand draws.
#[test]
#[ignore = "long: .ci/run mujoco"]
fn ten_thousand_arms_gain_no_energy() {
    check(0..10_000);
}
