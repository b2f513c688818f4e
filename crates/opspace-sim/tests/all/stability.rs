//! Stability of the simulation: no combination of inertias, gears, friction, brakes, end stops and steps diverges.

use crate::common::stiff_arms::{largest_energy_ratio, random_arm};
use opspace_sim::SimulatedArm;

/// Draws an arm for each seed, and checks that none has more energy than its motors and its weight can give it, and that at most
/// one in a hundred is refused.
fn check(seeds: std::ops::Range<u64>) {
    let (mut refused, count) = (0, seeds.end - seeds.start);
    let mut wrong = Vec::new();
    for seed in seeds {
        let config = random_arm(seed);
        let Ok(mut arm) = SimulatedArm::new(config.clone()) else {
            refused += 1;
            continue;
        };
        match largest_energy_ratio(&config, &mut arm) {
            Ok(ratio) if ratio < 1.5 => {}
            result => {
                eprintln!(
                    "{seed} {result:?} n {} hz {} gear {:?} stop {:?} brake {:?} bristle {:?} friction {:?} rotors {:?}",
                    config.model.n(),
                    config.simulated.physics_hz.get(),
                    config.simulated.gear,
                    config.simulated.end_stop,
                    config.simulated.brake,
                    config.simulated.bristle,
                    config
                        .joints
                        .iter()
                        .map(|j| (
                            j.torque_limit_nm.get(),
                            j.friction.static_nm.get(),
                            j.friction.viscous_nms_per_rad.get()
                        ))
                        .collect::<Vec<_>>(),
                    config.model.rotor_inertia()
                );
                wrong.push((seed, result))
            }
        }
    }
    println!(
        "{} of {count} wrong, {refused} refused: {:?}",
        wrong.len(),
        wrong.iter().take(20).collect::<Vec<_>>()
    );
    assert!(wrong.is_empty() && refused * 100 <= count);
}

#[test]
fn no_arm_gains_energy() {
    check(0..300);
}

/// The same with ten thousand draws.
#[test]
#[ignore = "long: .ci/run"]
fn none_of_ten_thousand_arms_gains_energy() {
    check(0..10_000);
}
