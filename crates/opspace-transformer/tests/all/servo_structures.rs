//! Every structure of servos: its law, and the gains that it states.
#![expect(clippy::unwrap_used, reason = "a test")]

use opspace_transformer::{ServoLaw, ServoParameters};
use std::f64::consts::TAU;

const PERIOD_S: f64 = 2e-4;

/// Relative rounding error of a product.
const ROUNDING: f64 = 1e-12;

/// Largest error of a torque at rest, Nm.
const TORQUE_NM: f64 = 1e-9;

/// Servo of each structure, by its name in files.
const EXAMPLES: [(&str, &str); 4] = [
    ("cascaded", "{ kp_per_s = 40.0, kv_nms_per_rad = 60.0, velocity_filter_hz = 600.0 }"),
    ("pid", "{ stiffness_nm_per_rad = 2400.0, damping_nms_per_rad = 60.0, derivative_filter_hz = 600.0 }"),
    ("transfer-function", "{ numerator = [4800.0, -2500.0], denominator = [1.0, -0.4] }"),
    ("velocity", "{ kv_nms_per_rad = 60.0, velocity_filter_hz = 600.0 }"),
];

fn servo(name: &str, keys: &str) -> ServoParameters {
    let table: toml::Table = toml::from_str(&format!("{name} = {keys}")).unwrap();
    table.try_into().unwrap()
}

/// Compared: the structures that there are, and those with an example here, which is read under its name.
#[test]
fn every_structure_has_an_example() {
    assert_eq!(EXAMPLES.map(|(name, _)| name), ServoParameters::NAMES);
    for (name, keys) in EXAMPLES {
        assert_eq!(servo(name, keys).name(), name);
    }
}

/// Compared: the stated gains, and the response of the law at a hundredth of the servo rate, where the filters of the velocity
/// shift it by less than a tenth.
#[test]
fn gains_are_those_of_the_law() {
    for (name, keys) in EXAMPLES {
        let servo = servo(name, keys);
        let gains = servo.gains(PERIOD_S);
        let law = ServoLaw::new(&servo, PERIOD_S).unwrap();
        let angle = TAU * 0.01;
        let [_, by_position] = law.response(nalgebra::Complex::from_polar(1.0, angle));
        let stated = nalgebra::Complex::new(-gains.stiffness, -gains.damping * angle / PERIOD_S);
        let difference = (by_position - stated).norm() / stated.norm();
        assert!(difference < 0.15, "{name}: {by_position} is not {stated}");
    }
}

/// Compared: the torques of a law at rest, and those that were asked for, before and after the servo is scaled.
#[test]
fn law_rests_with_a_torque() {
    for (name, keys) in EXAMPLES {
        let servo = servo(name, keys);
        for servo in [servo.scaled(1.1, 0.8), servo] {
            let law = ServoLaw::new(&servo, PERIOD_S).unwrap();
            let (mut memory, setpoint) = law.rest(0.3, 5.0);
            let torque = law.step(&mut memory, setpoint, 0.3);
            assert!((torque - 5.0).abs() < TORQUE_NM, "{name}: {torque}");
        }
    }
}

/// Compared: the gains of a scaled servo, and the scaled gains.
#[test]
fn scale_multiplies_the_gains() {
    for (name, keys) in EXAMPLES {
        let servo = servo(name, keys);
        let (gains, scaled) = (servo.gains(PERIOD_S), servo.scaled(1.5, 0.5).gains(PERIOD_S));
        assert!((scaled.stiffness - 0.75 * gains.stiffness).abs() <= ROUNDING * gains.stiffness, "{name}");
        let of_loop = name == "transfer-function";
        let damping = if of_loop { 0.75 } else { 0.5 } * gains.damping;
        assert!((scaled.damping - damping).abs() <= ROUNDING * damping, "{name}");
    }
}

/// Compared: keys of identified gains, and those with which the servo is read; and the gains of what is read.
#[test]
fn identified_keys_are_read() {
    use opspace_transformer::IdentifiedGains;
    let found = IdentifiedGains { kp_per_s: 30.0, kv_nms_per_rad: 50.0, filter_hz: 500.0 };
    let mut identified = 0;
    for (name, keys) in EXAMPLES {
        let Ok(keys) = servo(name, keys).structure().identified() else { continue };
        let written = keys(&found).map(|(key, value)| format!("{key} = {value:?}")).join(", ");
        let gains = servo(name, &format!("{{ {written} }}")).gains(PERIOD_S);
        assert_eq!((gains.stiffness, gains.damping), (1500.0, 50.0), "{name}");
        identified += 1;
    }
    assert_eq!(identified, 2);
}
