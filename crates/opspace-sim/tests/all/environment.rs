//! Tests of operators, pushes, walls and the force sensor against their definitions.

use crate::common::{object, parsed};
use nalgebra::Vector3;
use opspace_model::Force;
use opspace_sim::EnvironmentObject;
use opspace_sim::force_sensor::SimulatedForceSensor;
use opspace_sim::parameters::ForceSensorParameters;
use opspace_sim::random::{RngStream, generator};
use std::f64::consts::TAU;

/// Duration of a step of the plant, s.
const STEP_S: f64 = 5e-5;

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

const HOME: Vector3<f64> = Vector3::new(0.3, -0.1, -0.2);

/// Returns the offset of an operator's hand over time: the force of a spring of 1 N/m without damping on a frame at
/// home.
fn offset_of_hand(stream: u32) -> impl FnMut(f64) -> Vector3<f64> {
    let parameters = object(
        r#"
        [spring]
        frame = "hand"
        stiffness_n_per_m = 1.0
        damping_ns_per_m = 0.0
        motion.random = { rms_m = 0.04, from_hz = 0.1, to_hz = 0.7, ramp_s = 1.0 }
        "#,
    );
    let mut hand = EnvironmentObject::new(
        &parameters,
        HOME,
        GRAVITY,
        generator(5, RngStream::EnvironmentObject(stream)),
    );
    move |t| hand.force(t, STEP_S, &HOME, &Vector3::zeros())
}

/// Compared: rms of the motion over a long time, and the configured rms.
#[test]
fn operator_motion_has_requested_rms() {
    // Error caused by sines of nearby frequencies, which beat; it is small over 4000 s.
    const TOLERANCE: f64 = 0.05;
    let mut offset = offset_of_hand(0);
    let samples = 40_000;
    let squares: Vector3<f64> = (0..samples).map(|k| offset(2.0 + 0.1 * f64::from(k)).map(|x| x * x)).sum();
    for square in squares.iter() {
        let rms = (square / f64::from(samples)).sqrt();
        assert!((rms / 0.04 - 1.0).abs() < TOLERANCE, "{rms} m");
    }
}

/// Compared: power of the motion inside and outside its band, from Fourier sums at single frequencies with a Hann
/// window.
#[test]
fn operator_motion_stays_within_its_band() {
    const OUTSIDE: f64 = 1e-4;
    let mut offset = offset_of_hand(0);
    let (duration_s, rate_hz) = (400.0, 10.0);
    let samples: Vec<(f64, f64)> = (0..(duration_s * rate_hz) as u32)
        .map(|k| {
            let t = f64::from(k) / rate_hz;
            let window = 0.5 - 0.5 * (TAU * t / duration_s).cos();
            (t, window * offset(5.0 + t).x)
        })
        .collect();
    let power = |hz: f64| {
        let (re, im) = samples.iter().fold((0.0, 0.0), |(re, im), &(t, x)| {
            let (sin, cos) = (TAU * hz * t).sin_cos();
            (re + x * cos, im + x * sin)
        });
        re * re + im * im
    };
    let band = |from: f64, to: f64| {
        let step = 1.0 / duration_s;
        (0..((to - from) / step) as u32).map(|k| power(from + f64::from(k) * step)).sum::<f64>()
    };
    // Spectral lines are four bins wide with the window.
    let margin = 4.0 / duration_s;
    let inside = band(0.1 - margin, 0.7 + margin);
    let outside = band(0.0, 0.1 - margin) + band(0.7 + margin, 3.0);
    assert!(inside > 0.0 && outside < OUTSIDE * inside, "{outside} of {inside}");
}

/// Checks that the operator's force is zero at the beginning, and its value for offsets and speeds of both signs.
#[test]
fn operator_starts_at_rest_and_pulls_the_frame() {
    let mut offset = offset_of_hand(0);
    assert_eq!(offset(0.0), Vector3::zeros());
    assert!(offset(0.05).norm() < 1e-3 * 0.04 * 10.0, "comes in smoothly: {}", offset(0.05));
    let text = |motion: &str| {
        format!(
            "[spring]\nframe = 'hand'\nstiffness_n_per_m = 200.0\ndamping_ns_per_m = 15.0\ngain = [1.0, 0.5, 0.0]\nmotion.{motion}"
        )
    };
    let mut still = EnvironmentObject::new(
        &object(&text("still = {}")),
        HOME,
        GRAVITY,
        generator(1, RngStream::EnvironmentObject(0)),
    );
    let force =
        still.force(3.0, STEP_S, &(HOME + Vector3::new(0.01, 0.02, 0.03)), &Vector3::new(0.1, -0.2, 0.3));
    // By hand: -200 0.01 - 15 0.1; half of -200 0.02 + 15 0.2; zero.
    assert!((force - Vector3::new(-3.5, -0.5, 0.0)).norm() < 1e-12, "{force}");
    // The damper acts relative to the hand's velocity, the derivative of its offset.
    let random = "random = { rms_m = 0.04, from_hz = 0.1, to_hz = 0.7, ramp_s = 1.0 }";
    let mut moving = EnvironmentObject::new(
        &object(&text(random)),
        HOME,
        GRAVITY,
        generator(1, RngStream::EnvironmentObject(0)),
    );
    let mut at = |t: f64| moving.force(t, STEP_S, &HOME, &Vector3::zeros()).x;
    let mut spring_only = EnvironmentObject::new(
        &object(&text(random).replace("damping_ns_per_m = 15.0", "damping_ns_per_m = 0.0")),
        HOME,
        GRAVITY,
        generator(1, RngStream::EnvironmentObject(0)),
    );
    let mut offset = |t: f64| spring_only.force(t, STEP_S, &HOME, &Vector3::zeros()).x / 200.0;
    for t in [0.4, 1.3, 5.7] {
        let speed = (offset(t + 1e-5) - offset(t - 1e-5)) / 2e-5;
        assert!((at(t) - 200.0 * offset(t) - 15.0 * speed).abs() < 1e-6, "at {t} s");
    }
}

/// Checks that two streams of one seed differ, and that one stream is repeatable.
#[test]
fn random_streams_are_independent() {
    assert_eq!(offset_of_hand(0)(3.0), offset_of_hand(0)(3.0));
    assert_ne!(offset_of_hand(0)(3.0), offset_of_hand(1)(3.0));
}

/// Compared: force and impulse of a push, and a half sine, whose mean is 2/π of its peak.
#[test]
fn push_is_half_a_sine() {
    let parameters = object(
        "[pushes]\nframe = 'hand'\npush = [{ at_s = 1.0, duration_s = 0.5, force_n = [10.0, -4.0, 0.0] }]",
    );
    let mut push =
        EnvironmentObject::new(&parameters, HOME, GRAVITY, generator(1, RngStream::EnvironmentObject(0)));
    let mut force = |t: f64| push.force(t, STEP_S, &HOME, &Vector3::zeros());
    assert_eq!(force(0.999), Vector3::zeros());
    assert_eq!(force(1.501), Vector3::zeros());
    assert!((force(1.25) - Vector3::new(10.0, -4.0, 0.0)).norm() < 1e-12);
    let impulse: f64 = (0..20_000).map(|k| force(f64::from(k) * 1e-4).x * 1e-4).sum();
    assert!((impulse - 10.0 * 0.5 * 2.0 / (TAU / 2.0)).abs() < 1e-5, "{impulse} Ns");
}

/// Compared: forces of a push in each shape at some fractions of its duration, and their definitions.
#[test]
fn push_has_its_shape() {
    let at = [0.05, 0.2, 0.3, 0.5, 0.7, 0.9];
    for (shape, expected) in [
        ("'step'", [1.0; 6]),
        ("'ramp'", [0.1, 0.4, 0.6, 1.0, 0.6, 0.2]),
        ("'hold'", [0.2, 0.8, 1.0, 1.0, 1.0, 0.4]),
        // Levels of a third, two thirds, the peak, and back, a fifth of the duration each.
        ("{ staircase = { steps = 3 } }", [1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 1.0, 2.0 / 3.0, 1.0 / 3.0]),
    ] {
        let parameters = object(&format!(
            "[pushes]\nframe = 'hand'\npush = [{{ at_s = 1.0, duration_s = 2.0, shape = {shape}, force_n = [0.0, 0.0, -30.0] }}]"
        ));
        let mut push =
            EnvironmentObject::new(&parameters, HOME, GRAVITY, generator(1, RngStream::EnvironmentObject(0)));
        let mut force = |t: f64| push.force(t, STEP_S, &HOME, &Vector3::zeros());
        for (u, share) in at.into_iter().zip(expected) {
            // Levels change at exact fractions, which rounding may miss.
            let found = force(1.0 + 2.0 * u + 1e-9);
            assert!((found.z + 30.0 * share).abs() < 1e-5, "{shape} at {u}: {found}");
        }
        assert_eq!([force(0.99), force(3.01)], [Vector3::zeros(); 2], "{shape}");
    }
}

/// Compared: the wall's force at many positions and velocities, and its definition: along the normal, outwards only,
/// zero in front of the wall.
#[test]
fn wall_pushes_and_never_pulls() {
    let parameters = object(
        r#"
        [wall]
        frame = "hand"
        point_m = [0.3, 0.0, 0.0]
        normal = [-2.0, 0.0, 0.0]
        stiffness_n_per_m = 5000.0
        damping_ns_per_m = 50.0
        "#,
    );
    let mut wall =
        EnvironmentObject::new(&parameters, HOME, GRAVITY, generator(1, RngStream::EnvironmentObject(0)));
    let mut force =
        |x: f64, v: f64| wall.force(0.0, STEP_S, &Vector3::new(x, 0.2, -0.3), &Vector3::new(v, 1.0, -1.0));
    for v in [-3.0, -0.1, 0.0, 0.1, 3.0] {
        assert_eq!(force(0.2999, v), Vector3::zeros(), "before the wall");
        for depth in [1e-5, 1e-3, 1e-2] {
            let push = force(0.3 + depth, v);
            assert!(push.x <= 0.0 && push.y == 0.0 && push.z == 0.0, "{push}");
            let expected = (5000.0 * depth + 50.0 * v).max(0.0);
            assert!((push.x + expected).abs() < 1e-9, "{push} for {expected}");
        }
    }
}

fn sensor(bias: f64, noise: f64, seed: u64) -> SimulatedForceSensor {
    let parameters: ForceSensorParameters = parsed(&format!(
        "bandwidth_hz = 100.0\nnoise_n = {noise}\nnoise_nm = {noise}\nbias_n = {bias}\nbias_nm = {bias}"
    ));
    SimulatedForceSensor::new(&parameters, 1e-4, generator(seed, RngStream::ForceSensor(0)))
}

/// Compared: the response to a step, and 1 − exp(−ω t); the amplitude of a sine at the bandwidth, and 1/√2.
#[test]
fn force_sensor_has_its_bandwidth() {
    let mut step = sensor(0.0, 0.0, 1);
    let pull = Force { linear: Vector3::new(3.0, 0.0, 0.0), angular: Vector3::new(0.0, -1.0, 0.0) };
    for k in 1..100 {
        step.follow(&pull);
        let share = 1.0 - (-TAU * 100.0 * 1e-4 * f64::from(k)).exp();
        let reading = step.read();
        assert!((reading.linear.x - 3.0 * share).abs() < 1e-12);
        assert!((reading.angular.y + share).abs() < 1e-12);
    }
    let mut sine = sensor(0.0, 0.0, 1);
    let mut largest = 0.0_f64;
    for k in 0..2000 {
        let force = (TAU * 100.0 * 1e-4 * f64::from(k)).sin();
        sine.follow(&Force { linear: Vector3::new(force, 0.0, 0.0), angular: Vector3::zeros() });
        if k > 1000 {
            largest = largest.max(sine.read().linear.x.abs());
        }
    }
    // The sample-and-hold at a hundred samples per period adds a small error.
    assert!((largest - 0.5_f64.sqrt()).abs() < 0.01, "{largest}");
}

/// Compared: mean and spread of many readings at rest, and the configured bias and noise.
#[test]
fn force_sensor_has_constant_bias_and_white_noise() {
    let readings = |bias: f64, noise: f64, seed: u64| -> Vec<f64> {
        let mut sensor = sensor(bias, noise, seed);
        (0..4000).map(|_| sensor.read().linear.z).collect()
    };
    let biased = readings(2.0, 0.0, 1);
    assert!(biased.iter().all(|f| *f == biased[0]) && biased[0] != 0.0 && biased[0].abs() <= 2.0);
    assert_ne!(biased[0], readings(2.0, 0.0, 2)[0], "another sensor, another bias");
    let noisy = readings(0.0, 0.5, 1);
    let rms = (noisy.iter().map(|f| f * f).sum::<f64>() / 4000.0).sqrt();
    // Tolerance: four standard deviations of the estimate.
    assert!((rms / 0.5 - 1.0).abs() < 4.0 / (2.0 * 4000.0_f64).sqrt(), "{rms}");
}

/// Compared: the readings of a sensor with drift, and a straight line within the configured rate; noise and bias are those of
/// a sensor without drift.
#[test]
fn force_sensor_drifts_at_a_constant_rate() {
    let text = "bandwidth_hz = 100.0\nnoise_n = 0.0\nnoise_nm = 0.0\nbias_n = 1.0\nbias_nm = 1.0";
    let new =
        |text: &str| SimulatedForceSensor::new(&parsed(text), 1e-3, generator(3, RngStream::ForceSensor(0)));
    let (mut still, mut drifting) = (new(text), new(&format!("{text}\ndrift_n_per_s = 0.2")));
    let mut errors = Vec::new();
    for _ in 0..3 {
        for _ in 0..1000 {
            still.follow(&Force::zero());
            drifting.follow(&Force::zero());
        }
        let (a, b) = (drifting.read(), still.read());
        assert_eq!(a.angular, b.angular, "no drift of moments");
        errors.push(a.linear - b.linear);
    }
    assert!((errors[1] - errors[0] * 2.0).norm() < 1e-9 && (errors[2] - errors[0] * 3.0).norm() < 1e-9);
    assert!(errors[0].amax() <= 0.2 && errors[0].norm() > 1e-3, "{} N after 1 s", errors[0]);
}
