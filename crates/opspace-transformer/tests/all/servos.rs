//! Servos of every structure against their recursions, which are written out here.
#![expect(clippy::unwrap_used, reason = "a test")]

use opspace_backend::CommandKind;
use opspace_transformer::{ServoError, ServoLaw, ServoParameters};
use std::f64::consts::TAU;

/// Rounding of sums of a few terms of order 1 to 1000.
const ROUNDING: f64 = 1e-9;

const PERIOD_S: f64 = 1e-3;

/// Fraction of the previous velocity that a low-pass of 200 Hz keeps after one tick.
fn keep() -> f64 {
    (-TAU * 200.0 * PERIOD_S).exp()
}

fn position(k: usize) -> f64 {
    let k = k as f64;
    0.3 * (0.07 * k).sin() + 0.01 * (1.3 * k).cos()
}

fn desired(k: usize) -> f64 {
    0.4 * (0.05 * k as f64).cos()
}

/// A low-passed finite difference of a signal up to tick k, as a sum over all past differences.
fn rate(signal: impl Fn(usize) -> f64, k: usize) -> f64 {
    let share = |j: usize| (1.0 - keep()) * keep().powi((k - j) as i32);
    (1..=k).map(|j| share(j) * (signal(j) - signal(j - 1)) / PERIOD_S).sum()
}

const CASCADED: &str = "cascaded = { kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0 }";
const CASCADED_INTEGRAL: &str = "cascaded = { kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0, \
                                 velocity_integral_time_s = 0.04 }";
const PD: &str =
    "pid = { stiffness_nm_per_rad = 4000.0, damping_nms_per_rad = 60.0, derivative_filter_hz = 200.0 }";
const PID_OF_ERROR: &str = "pid = { stiffness_nm_per_rad = 4000.0, damping_nms_per_rad = 60.0, derivative_filter_hz = 200.0, \
                            derivative_of = \"error\", integral_nm_per_rad_s = 9000.0 }";
const LAGGING: &str =
    "transfer-function = { numerator = [0.0, 800.0, -500.0], denominator = [2.0, -1.2, 0.1] }";
const VELOCITY: &str = "velocity = { kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0 }";
const VELOCITY_INTEGRAL: &str =
    "velocity = { kv_nms_per_rad = 90.0, ki_nm_per_rad = 700.0, velocity_filter_hz = 200.0 }";
const ALL: [&str; 7] = [CASCADED, CASCADED_INTEGRAL, PD, PID_OF_ERROR, LAGGING, VELOCITY, VELOCITY_INTEGRAL];

fn law(servo: &str) -> ServoLaw {
    let parameters: ServoParameters = toml::from_str(servo).unwrap();
    ServoLaw::new(&parameters, PERIOD_S).unwrap()
}

/// Torques at ticks 1 to 60, after rest without torque at the position of tick 0.
fn torques(servo: &str) -> Vec<f64> {
    let law = law(servo);
    let (mut memory, _) = law.rest(position(0), 0.0);
    (1..=60).map(|k| law.step(&mut memory, desired(k), position(k))).collect()
}

fn assert_same(servo: &str, expected: impl Fn(usize) -> f64) {
    for (torque, k) in torques(servo).into_iter().zip(1..) {
        let expected = expected(k);
        assert!(
            (torque - expected).abs() < ROUNDING * expected.abs().max(1.0),
            "{servo}, {k}: {torque} for {expected}"
        );
    }
}

#[test]
fn cascade_is_equation_k9_with_filtered_difference() {
    assert_same(CASCADED, |k| 90.0 * (50.0 * (desired(k) - position(k)) - rate(position, k)));
}

#[test]
fn cascade_integral_integrates_velocity_error() {
    let error = |k: usize| 50.0 * (desired(k) - position(k)) - rate(position, k);
    assert_same(CASCADED_INTEGRAL, |k| {
        let integral: f64 = (1..=k).map(|j| error(j) * PERIOD_S / 0.04).sum();
        90.0 * (error(k) + integral)
    });
}

#[test]
fn pd_servo_damps_measured_velocity() {
    assert_same(PD, |k| 4000.0 * (desired(k) - position(k)) - 60.0 * rate(position, k));
}

#[test]
fn pid_servo_may_differentiate_its_error() {
    // The error before the first tick is zero.
    let error = |k: usize| if k == 0 { 0.0 } else { desired(k) - position(k) };
    assert_same(PID_OF_ERROR, |k| {
        let integral: f64 = (1..=k).map(|j| 9000.0 * PERIOD_S * error(j)).sum();
        4000.0 * error(k) + 60.0 * rate(error, k) + integral
    });
}

/// Compared: torques of velocity servos, and sums over all past velocity errors. The setpoint is a velocity.
#[test]
fn velocity_servo_controls_filtered_difference() {
    let error = |k: usize| desired(k) - rate(position, k);
    assert_same(VELOCITY, |k| 90.0 * error(k));
    assert_same(VELOCITY_INTEGRAL, |k| {
        90.0 * error(k) + (1..=k).map(|j| 700.0 * PERIOD_S * error(j)).sum::<f64>()
    });
    let parameters: ServoParameters = toml::from_str(VELOCITY_INTEGRAL).unwrap();
    assert_eq!(parameters.takes(), CommandKind::Velocity);
    let doubled = "velocity = { kv_nms_per_rad = 180.0, ki_nm_per_rad = 1400.0, velocity_filter_hz = 200.0 }";
    assert_eq!(parameters.scaled(3.0, 2.0), toml::from_str(doubled).unwrap());
}

#[test]
fn transfer_function_matches_difference_equation() {
    let error = |k: usize| if k == 0 { 0.0 } else { desired(k) - position(k) };
    let mut torque = vec![0.0; 61];
    for k in 1..=60_usize {
        let before = |signal: &dyn Fn(usize) -> f64, ticks: usize| k.checked_sub(ticks).map_or(0.0, signal);
        let given = 800.0 * before(&error, 1) - 500.0 * before(&error, 2);
        let kept = -1.2 * before(&|j| torque[j], 1) + 0.1 * before(&|j| torque[j], 2);
        torque[k] = (given - kept) / 2.0;
    }
    assert_same(LAGGING, |k| torque[k]);
}

/// Compared: the torque of each servo at rest, and the torque for which its state and setpoint are computed.
#[test]
fn servo_at_rest_holds_requested_torque() {
    for servo in ALL {
        let law = law(servo);
        let (mut memory, setpoint) = law.rest(0.7, 3.5);
        for tick in 0..20 {
            let torque = law.step(&mut memory, setpoint, 0.7);
            assert!((torque - 3.5).abs() < 1e-6, "{servo}, tick {tick}: {torque}");
        }
    }
}

/// Checks velocity setpoints at rest under a load: load/kv without an integral, zero with one. At another setpoint the
/// torque of a servo without an integral differs by kv times the difference.
#[test]
fn velocity_servo_rests_at_load_over_kv_or_zero() {
    let (_, setpoint) = law(VELOCITY).rest(0.7, 3.5);
    assert!((setpoint - 3.5 / 90.0).abs() < ROUNDING, "{setpoint}");
    let (mut memory, _) = law(VELOCITY).rest(0.7, 3.5);
    let torque = law(VELOCITY).step(&mut memory, 0.0, 0.7);
    assert!(torque.abs() < ROUNDING, "{torque}");
    let (_, setpoint) = law(VELOCITY_INTEGRAL).rest(0.7, 3.5);
    assert!(setpoint.abs() < ROUNDING, "{setpoint}");
}

/// Checks the gains of a velocity servo: damping kv and stiffness zero, so that its position-loop gain is zero and
/// defined.
#[test]
fn velocity_servo_has_no_stiffness() {
    for servo in [VELOCITY, VELOCITY_INTEGRAL] {
        let parameters: ServoParameters = toml::from_str(servo).unwrap();
        let gains = parameters.gains(PERIOD_S);
        assert_eq!((gains.stiffness, gains.damping, gains.position_loop()), (0.0, 90.0, 0.0));
        assert!(!parameters.has_two_gains());
    }
}

/// Compared: the frequency response at one frequency, and the Fourier coefficient of the torques under a long sine of
/// it.
#[test]
fn frequency_response_matches_sine() {
    for servo in [CASCADED, PD, LAGGING, VELOCITY] {
        let law = law(servo);
        let ticks = 50_usize;
        let z = nalgebra::Complex::from_polar(1.0, TAU / ticks as f64);
        for (channel, response) in law.response(z).into_iter().enumerate() {
            let (mut memory, _) = law.rest(0.0, 0.0);
            let mut sum = nalgebra::Complex::new(0.0, 0.0);
            for k in 0..40 * ticks {
                let input = z.powu(k as u32).re;
                let (setpoint, position) = if channel == 0 { (input, 0.0) } else { (0.0, input) };
                let torque = law.step(&mut memory, setpoint, position);
                // Last period, after the transient.
                if k >= 39 * ticks {
                    sum += z.powu(k as u32).conj() * torque * 2.0 / ticks as f64;
                }
            }
            assert!((sum - response).norm() < 1e-6 * response.norm(), "{servo}: {sum} for {response}");
        }
    }
}

#[test]
fn unusable_transfer_function_is_refused() {
    let refused = |numerator: &str, denominator: &str| {
        let text = format!("transfer-function = {{ numerator = {numerator}, denominator = {denominator} }}");
        ServoLaw::new(&toml::from_str(&text).unwrap(), PERIOD_S).unwrap_err()
    };
    assert_eq!(refused("[1.0]", "[0.0, 1.0]"), ServoError::Improper);
    assert_eq!(refused("[1.0]", "[]"), ServoError::Improper);
    assert_eq!(refused("[0.0, 0.0]", "[1.0]"), ServoError::NoTorque);
    assert_eq!(refused("[]", "[1.0]"), ServoError::NoTorque);
    assert_eq!(refused("[1.0, -1.0]", "[1.0, -0.5]"), ServoError::HoldsNothing);
    assert_eq!(refused("[1.0, 0, 0, 0, 0, 0, 0, 1.0]", "[1.0]"), ServoError::Order { order: 7 });
}
