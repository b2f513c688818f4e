//! Diagnostics of the couplings between robots.

use opspace_coupling::{Passivity, Reflected};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::couplings::Coupling;
use opspace_experiment::run::scenario::Scenario;

/// Predicts problems of the couplings. Those of the robots are [`crate::diagnostics`] of each of them.
#[must_use]
pub fn coupling_diagnostics(scenario: &Scenario) -> Vec<Finding> {
    // Wave variables are passive by themselves.
    let is_off = |coupling: &&Coupling| {
        coupling.teleoperation().is_some_and(|law| {
            law.passivity == Passivity::Off && !matches!(law.reflect, Reflected::Waves { .. })
        })
    };
    let without_limit = scenario.couplings.iter().filter(is_off).map(|coupling| {
        Finding::new(
            Code::NoPassivityControl,
            &["couplings", &coupling.name, "teleoperation", "passivity"],
            "passivity control is off: with a delay, or at a stiff surface, the robots can give more energy to the operator and \
             the environment than they received, without a bound"
                .to_owned(),
            "remove `passivity = \"off\"`, unless the energies are to be observed only".to_owned(),
        )
    });
    without_limit.collect()
}
