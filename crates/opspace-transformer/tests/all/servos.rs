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
const FED_FORWARD: &str = "cascaded = { kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0, \
                           velocity_feed_forward = 0.8 }";
const FED_FORWARD_PD: &str = "pid = { stiffness_nm_per_rad = 4000.0, damping_nms_per_rad = 60.0, derivative_filter_hz = 200.0, \
                              velocity_feed_forward = 1.0 }";
const FILTERED: &str = "cascaded = { kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0, \
                        setpoint_filter = { first-order = { cutoff_hz = 40.0 } } }";
/// The servo with the longest memory.
const EVERYTHING: &str = "cascaded = { kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0, \
                          velocity_integral_time_s = 0.04, velocity_feed_forward = 0.8, \
                          acceleration_feed_forward_kg_m2 = 0.7, setpoint_filter = { second-order = { \
                          natural_frequency_hz = 60.0, damping_ratio = 0.6 } } }";
const EVERYTHING_PID: &str = "pid = { stiffness_nm_per_rad = 4000.0, damping_nms_per_rad = 60.0, derivative_filter_hz = 200.0, \
                              integral_nm_per_rad_s = 9000.0, velocity_feed_forward = 0.8, \
                              acceleration_feed_forward_kg_m2 = 0.7, setpoint_filter = { second-order = { \
                              natural_frequency_hz = 60.0, damping_ratio = 0.6 } } }";
const ALL: [&str; 12] = [
    CASCADED,
    CASCADED_INTEGRAL,
    PD,
    PID_OF_ERROR,
    LAGGING,
    VELOCITY,
    VELOCITY_INTEGRAL,
    FED_FORWARD,
    FED_FORWARD_PD,
    FILTERED,
    EVERYTHING,
    EVERYTHING_PID,
];

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

/// Compared: a servo of proportional gain alone, without a filter, and its position error; damping without a filter is refused.
#[test]
fn spring_needs_no_derivative_filter() {
    let spring = "pid = { stiffness_nm_per_rad = 4000.0, damping_nms_per_rad = 0.0 }";
    assert_same(spring, |k| 4000.0 * (desired(k) - position(k)));
    let damped = toml::from_str(&spring.replace("0.0 }", "60.0 }")).unwrap();
    let refused = ServoLaw::new(&damped, PERIOD_S).unwrap_err();
    assert_eq!(refused, ServoError::UnfilteredDerivative);
    assert!(refused.to_string().contains("derivative_filter_hz is required"), "{refused}");
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

/// Setpoint of a drive at rest at `position(0)`, and then that of the other tests.
fn setpoint(k: usize) -> f64 {
    if k == 0 { position(0) } else { desired(k) }
}

/// First difference of a signal over its period, zero at tick 0.
fn velocity(signal: impl Fn(usize) -> f64, k: usize) -> f64 {
    if k == 0 { 0.0 } else { (signal(k) - signal(k - 1)) / PERIOD_S }
}

/// Compared: torques of a cascade and of a PD servo, and the equation of the drive with the difference of the setpoints.
#[test]
fn velocity_feed_forward_adds_setpoint_difference() {
    assert_same(FED_FORWARD, |k| {
        let velocity = 50.0 * (desired(k) - position(k)) + 0.8 * velocity(setpoint, k) - rate(position, k);
        90.0 * velocity
    });
    assert_same(FED_FORWARD_PD, |k| {
        4000.0 * (desired(k) - position(k)) + 60.0 * (velocity(setpoint, k) - rate(position, k))
    });
}

/// Compared: the torque of a step of a held setpoint in each tick, and an impulse of kv ff/Ts in the first of them; and
/// the constant torque of a ramp.
#[test]
fn velocity_feed_forward_of_held_and_of_interpolated_setpoints() {
    let (fed, plain) = (law(FED_FORWARD), law(CASCADED));
    let extra = |setpoints: &dyn Fn(u32) -> f64| -> Vec<f64> {
        let (mut memory, mut plain_memory) = (fed.rest(0.0, 0.0).0, plain.rest(0.0, 0.0).0);
        (0..5)
            .map(|k| {
                fed.step(&mut memory, setpoints(k), 0.0) - plain.step(&mut plain_memory, setpoints(k), 0.0)
            })
            .collect()
    };
    let impulse = 90.0 * 0.8 * 0.01 / PERIOD_S;
    for (torque, expected) in extra(&|_| 0.01).into_iter().zip([impulse, 0.0, 0.0, 0.0, 0.0]) {
        assert!((torque - expected).abs() < ROUNDING * impulse, "held: {torque} for {expected}");
    }
    for torque in extra(&|k| 0.01 * f64::from(k + 1) / 5.0) {
        assert!((torque - impulse / 5.0).abs() < ROUNDING * impulse, "interpolated: {torque}");
    }
}

/// Position and velocity of a filter of second order after rest at `from`, for setpoints constant over each period: its
/// differential equation in steps of a thousandth of the period, by the classical Runge-Kutta method.
fn second_order(natural: f64, damping: f64, from: f64, setpoints: &[f64]) -> Vec<f64> {
    const STEPS: u32 = 1000;
    let h = PERIOD_S / f64::from(STEPS);
    let rate = |[x, v]: [f64; 2], u: f64| [v, natural * natural * (u - x) - 2.0 * damping * natural * v];
    let plus = |a: [f64; 2], b: [f64; 2], scale: f64| [a[0] + scale * b[0], a[1] + scale * b[1]];
    let mut state = [from, 0.0];
    let mut output = Vec::new();
    for &u in setpoints {
        for _ in 0..STEPS {
            let k1 = rate(state, u);
            let k2 = rate(plus(state, k1, h / 2.0), u);
            let k3 = rate(plus(state, k2, h / 2.0), u);
            let k4 = rate(plus(state, k3, h), u);
            for (k, weight) in [(k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)] {
                state = plus(state, k, h * weight / 6.0);
            }
        }
        output.push(state[0]);
    }
    output
}

/// Compared: torques of the servos with every feature, and their equations with the setpoint that an integrator of the
/// filter's differential equation gives.
#[test]
fn filtered_and_fed_forward_servos_match_their_equations() {
    let setpoints: Vec<f64> = (1..=60).map(desired).collect();
    let filtered = second_order(TAU * 60.0, 0.6, position(0), &setpoints);
    let filtered = |k: usize| if k == 0 { position(0) } else { filtered[k - 1] };
    let acceleration = |k: usize| velocity(|j| velocity(filtered, j), k);
    let speed_error =
        |k: usize| 50.0 * (filtered(k) - position(k)) + 0.8 * velocity(filtered, k) - rate(position, k);
    assert_same(EVERYTHING, |k| {
        let integral: f64 = (1..=k).map(|j| speed_error(j) * PERIOD_S / 0.04).sum();
        90.0 * (speed_error(k) + integral) + 0.7 * acceleration(k)
    });
    let error = |k: usize| filtered(k) - position(k);
    assert_same(EVERYTHING_PID, |k| {
        let integral: f64 = (1..=k).map(|j| 9000.0 * PERIOD_S * error(j)).sum();
        let damping = 60.0 * (0.8 * velocity(filtered, k) - rate(position, k));
        4000.0 * error(k) + damping + integral + 0.7 * acceleration(k)
    });
}

/// Compared: the torque of a step of the setpoint through each filter over the stiffness, and the step response of the
/// continuous filter at the end of each servo period.
#[test]
fn setpoint_filters_have_continuous_step_responses() {
    let stiffness = 4500.0;
    let responses = |filter: &str| -> Vec<f64> {
        let law = law(&format!(
            "cascaded = {{ kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0, setpoint_filter = {filter} }}"
        ));
        let (mut memory, _) = law.rest(0.0, 0.0);
        (0..80).map(|_| law.step(&mut memory, 1.0, 0.0) / stiffness).collect()
    };
    let check = |filter: &str, exact: &dyn Fn(f64) -> f64| {
        for (response, k) in responses(filter).into_iter().zip(1..) {
            let expected = exact(f64::from(k) * PERIOD_S);
            assert!((response - expected).abs() < ROUNDING, "{filter}, tick {k}: {response} for {expected}");
        }
    };
    let w = TAU * 40.0;
    check("{ first-order = { cutoff_hz = 40.0 } }", &|t| 1.0 - (-w * t).exp());
    let of = |damping: f64| {
        format!("{{ second-order = {{ natural_frequency_hz = 40.0, damping_ratio = {damping:?} }} }}")
    };
    check(&of(0.5), &|t| {
        let ringing = w * (1.0_f64 - 0.25).sqrt();
        1.0 - (-0.5 * w * t).exp() * ((ringing * t).cos() + 0.5 * w / ringing * (ringing * t).sin())
    });
    check(&of(1.0), &|t| 1.0 - (1.0 + w * t) * (-w * t).exp());
    let split = (2.0_f64 * 2.0 - 1.0).sqrt();
    let [slow, fast] = [w * (2.0 - split), w * (2.0 + split)];
    check(&of(2.0), &|t| 1.0 - (fast * (-slow * t).exp() - slow * (-fast * t).exp()) / (fast - slow));
    // Poles that are far apart: the fast one overflows nothing.
    let last = responses("{ second-order = { natural_frequency_hz = 5000.0, damping_ratio = 1000.0 } }")[79];
    let slow: f64 = TAU * 5000.0 / 2000.0;
    assert!((last - (1.0 - (-slow * 0.08).exp())).abs() < 1e-5, "{last}");
}

/// Compared: averaged setpoints, and the means of the last setpoints, taken anew at each tick; the frequency response of the
/// servo that averages, and the Fourier coefficient of its torques; the torque at rest before and after a step.
#[test]
fn averaged_setpoints_are_means_of_the_last_ones() {
    let average = |times: &str| {
        law(&format!(
            "cascaded = {{ kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0, setpoint_filter = {{ \
             moving-average = {{ {times} }} }} }}"
        ))
    };
    for (times, [first, second]) in [
        ("time_s = 0.0068", [7, 1]),
        ("time_s = 0.012, second_time_s = 0.005", [12, 5]),
        ("time_s = 1e-9", [1, 1]),
    ] {
        let law = average(times);
        let mut setpoints = law.setpoint_average();
        setpoints.rest(desired(0));
        let mean = |of: &dyn Fn(usize) -> f64, ticks: usize, k: usize| {
            (0..ticks).map(|back| of(k.saturating_sub(back))).sum::<f64>() / ticks as f64
        };
        let once = |k: usize| mean(&desired, first, k);
        for k in 1..=60 {
            let (averaged, expected) = (setpoints.step(desired(k)), mean(&once, second, k));
            assert!((averaged - expected).abs() < 1e-14, "{times}, {k}: {averaged} for {expected}");
        }
        let ticks = 50_usize;
        let z = nalgebra::Complex::from_polar(1.0, TAU / ticks as f64);
        let (mut memory, mut setpoints) = (law.rest(0.0, 0.0).0, law.setpoint_average());
        let mut sum = nalgebra::Complex::new(0.0, 0.0);
        for k in 0..40 * ticks {
            let torque = law.step(&mut memory, setpoints.step(z.powu(k as u32).re), 0.0);
            if k >= 39 * ticks {
                sum += z.powu(k as u32).conj() * torque * 2.0 / ticks as f64;
            }
        }
        let [response, _] = law.response(z);
        assert!((sum - response).norm() < 1e-6 * response.norm(), "{times}: {sum} for {response}");
    }
    let text = "cascaded = { kp_per_s = 50.0, kv_nms_per_rad = 90.0, velocity_filter_hz = 200.0, setpoint_filter = { \
                moving-average = { time_s = 5.0 } } }";
    let refused = ServoLaw::new(&toml::from_str(text).unwrap(), PERIOD_S).unwrap_err();
    assert_eq!(refused, ServoError::Average { ticks: 5000.0 });
}

/// Compared: a servo whose gains and feed-forward were changed, and a servo that was built with the gains, at rest and under
/// the motion of the other tests.
#[test]
fn retuned_servo_is_servo_of_new_gains() {
    for (servo, retuned) in [
        (CASCADED, "cascaded = { kp_per_s = 35.0, kv_nms_per_rad = 120.0, velocity_filter_hz = 200.0 }"),
        (
            FED_FORWARD,
            "cascaded = { kp_per_s = 35.0, kv_nms_per_rad = 120.0, velocity_filter_hz = 200.0, \
             velocity_feed_forward = 0.7 }",
        ),
        (
            FED_FORWARD_PD,
            "pid = { stiffness_nm_per_rad = 4200.0, damping_nms_per_rad = 120.0, derivative_filter_hz = 200.0, \
             velocity_feed_forward = 1.0 }",
        ),
    ] {
        let gains = |servo: &str| {
            let parameters: ServoParameters = toml::from_str(servo).unwrap();
            assert!(parameters.has_two_gains());
            parameters.gains(PERIOD_S)
        };
        let (mut law, new) = (law(servo), law(retuned));
        let feed_forward =
            |servo: &str| toml::from_str::<ServoParameters>(servo).unwrap().velocity_feed_forward();
        let added = gains(retuned).damping * (feed_forward(retuned) - feed_forward(servo));
        law.retune(gains(servo), gains(retuned));
        if added != 0.0 {
            law.add_feed_forward(added, PERIOD_S);
        }
        let ((mut memory, setpoint), (mut new_memory, new_setpoint)) =
            (law.rest(0.7, 3.5), new.rest(0.7, 3.5));
        assert!((setpoint - new_setpoint).abs() < 1e-12, "{servo}: {setpoint} for {new_setpoint}");
        for k in 1..=60 {
            let torque = law.step(&mut memory, desired(k), position(k));
            let expected = new.step(&mut new_memory, desired(k), position(k));
            assert!(
                (torque - expected).abs() < ROUNDING * expected.abs(),
                "{servo}, {k}: {torque} for {expected}"
            );
        }
    }
    for servo in [FILTERED, EVERYTHING, EVERYTHING_PID, CASCADED_INTEGRAL] {
        let parameters: ServoParameters = toml::from_str(servo).unwrap();
        assert!(!parameters.has_two_gains(), "{servo}");
    }
}

/// Checks that a differentiated error and velocity feed-forward are refused together, and that a fraction is from 0 to
/// 1.
#[test]
fn feed_forward_out_of_range_or_twice_is_refused() {
    let text = PID_OF_ERROR.replace("9000.0 }", "9000.0, velocity_feed_forward = 0.5 }");
    let refused = ServoLaw::new(&toml::from_str(&text).unwrap(), PERIOD_S).unwrap_err();
    assert_eq!(refused, ServoError::FeedForwardTwice);
    let text = FED_FORWARD.replace("0.8", "1.2");
    let refused = toml::from_str::<ServoParameters>(&text).unwrap_err().to_string();
    assert!(refused.contains("from 0 to 1, got 1.2"), "{refused}");
    let text = FILTERED.replace("cutoff_hz = 40.0", "cutoff_hz = 40.0, damping_ratio = 1.0");
    let refused = toml::from_str::<ServoParameters>(&text).unwrap_err().to_string();
    assert!(refused.contains("damping_ratio, available keys: cutoff_hz"), "{refused}");
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
    for servo in [CASCADED, PD, LAGGING, VELOCITY, FED_FORWARD, FILTERED, FED_FORWARD_PD] {
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
