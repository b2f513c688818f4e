//! Gains from a measured closed loop.
#![expect(clippy::unwrap_used, reason = "a test")]

use opspace_transformer::{ClosedLoopModel, IdentificationError};

const INERTIA: f64 = 0.4;
const VISCOUS: f64 = 2.0;
const KP: f64 = 40.0;
const KV: f64 = 60.0;

/// Tolerance of floating-point solutions.
const EXACT: f64 = 1e-6;

/// Closed loop T of a mass with viscous friction under the cascade of equation (K9), and open loop H of the mass.
fn joint(zeros: &str) -> ClosedLoopModel {
    let text = format!(
        "closed_loop = {{ numerator = {zeros}, denominator = [{}, {}, {INERTIA}] }}\n\
         open_loop = {{ numerator = [1.0], denominator = [0.0, {VISCOUS}, {INERTIA}] }}\n\
         from_hz = 0.1\nto_hz = 20.0",
        KV * KP,
        KV + VISCOUS
    );
    toml::from_str(&text).unwrap()
}

fn measured() -> ClosedLoopModel {
    joint(&format!("[{}]", KV * KP))
}

/// Compared: gains split from T, and the gains from which T is made.
#[test]
fn closed_loop_is_split_into_its_gains() {
    let gains = measured().split().unwrap();
    assert!((gains.damping / KV - 1.0).abs() < EXACT, "{gains:?}");
    assert!((gains.position_loop() / KP - 1.0).abs() < EXACT, "{gains:?}");
}

#[test]
fn loop_that_has_no_gains_is_refused_with_reason() {
    let zero = joint("[0.0]").split().unwrap_err();
    assert_eq!(zero, IdentificationError::Zero { what: "closed_loop.numerator" });
    let mut negative = measured();
    negative.closed_loop.numerator[0] *= -1.0;
    assert!(matches!(negative.split().unwrap_err(), IdentificationError::Split { .. }));
    let mut band = measured();
    std::mem::swap(&mut band.from_hz, &mut band.to_hz);
    assert_eq!(band.split().unwrap_err(), IdentificationError::Band);
}
