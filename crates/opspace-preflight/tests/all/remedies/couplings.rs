//! Remedies for couplings between robots.

use super::case::only;
use crate::project;
use opspace_experiment::{Code, Extensions, Files, Scenario};
use opspace_preflight::coupling_diagnostics;

/// Teleoperation of two arms, with settings.
fn teleoperation(settings: &[&str]) -> Scenario {
    let settings: Vec<String> = settings.iter().map(|setting| (*setting).to_owned()).collect();
    let path = project("tasks/experiments/teleop-wall.toml");
    Scenario::load_robots(&Extensions::default(), Files::Disk, &path, &settings, &[])
        .unwrap_or_else(|error| panic!("{error}"))
}

pub fn no_passivity_control(code: Code) {
    let off = "couplings.hands.teleoperation.passivity=\"off\"";
    let help = only(code, &coupling_diagnostics(&teleoperation(&[off]))).help;
    assert!(help.contains("remove `passivity = \"off\"`"), "{help}");
    assert_eq!(coupling_diagnostics(&teleoperation(&[])), []);
}
