//! Remedies for couplings between robots.

use super::case::only;
use crate::coupled_common::teleoperation;
use opspace_experiment::Code;
use opspace_preflight::coupling_diagnostics;

pub fn no_passivity_control(code: Code) {
    let off = "couplings.hands.teleoperation.passivity=\"off\"";
    let help = only(code, &coupling_diagnostics(&teleoperation(&[off]))).help;
    assert!(help.contains("remove `passivity = \"off\"`"), "{help}");
    assert_eq!(coupling_diagnostics(&teleoperation(&[])), []);
}
