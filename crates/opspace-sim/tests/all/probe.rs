//! Tests of the probing motion of an operator against its definition.

use crate::common::object;
use nalgebra::Vector3;
use opspace_sim::EnvironmentObject;
use opspace_sim::random::{RngStream, generator};
use std::f64::consts::TAU;

const LINES_HZ: [f64; 7] = [0.5, 0.75, 1.25, 1.75, 2.75, 3.5, 4.75];
const RMS_M: f64 = 0.01;
/// Common period of the lines, s.
const PERIOD_S: f64 = 4.0;
const STEP_S: f64 = 1e-3;
const FROM_S: f64 = 4.0;

/// Returns the force of an operator on a frame that stays at its start, over time, with these stiffness (N/m) and damping
/// (Ns/m).
fn operator(
    stiffness: f64,
    damping: f64,
    motion: &str,
    seed: u64,
) -> impl FnMut(f64) -> Vector3<f64> + use<> {
    let parameters = object(&format!(
        "[spring]\nframe = 'hand'\nstiffness_n_per_m = {stiffness:?}\ndamping_ns_per_m = {damping:?}\n{motion}"
    ));
    let random = generator(seed, RngStream::EnvironmentObject(0));
    let home = Vector3::new(0.3, -0.1, -0.2);
    let mut operator = EnvironmentObject::new(&parameters, home, Vector3::new(0.0, 0.0, -9.81), random);
    move |t| operator.force(t, STEP_S, &home, &Vector3::zeros())
}

/// Text of the probe along `axis`.
fn probe(axis: [f64; 3]) -> String {
    format!(
        "motion.scripted.probe = {{ rms_m = {RMS_M}, lines_hz = {LINES_HZ:?}, axis = {axis:?}, from_s = {FROM_S:?}, ramp_s = 0.5 }}"
    )
}

/// Offset of an operator along the world axes over one common period after the ramp, m.
fn one_period(axis: [f64; 3], seed: u64) -> Vec<Vector3<f64>> {
    let mut offset = operator(1.0, 0.0, &probe(axis), seed);
    (0..(PERIOD_S / STEP_S) as u32).map(|k| offset(FROM_S + 1.0 + f64::from(k) * STEP_S)).collect()
}

/// Compared: amplitudes of the discrete Fourier transform over one common period of the lines, where it has no leakage, and
/// `rms √(2/7)` at each line and zero at each other multiple of 0.25 Hz up to 10 Hz; and the rms of the motion along the
/// axis, and the configured rms.
#[test]
fn probe_has_its_lines_and_no_others() {
    // Rounding of the times, up to 10 s, at 5 Hz, and of sums of 4000 values.
    const TOLERANCE: f64 = 1e-11;
    let axis = Vector3::new(0.0, 3.0, -4.0);
    let motion = one_period(axis.into(), 5);
    let along: Vec<f64> = motion.iter().map(|offset| offset.dot(&axis) / 5.0).collect();
    let samples = along.len() as f64;
    for bin in 0..40 {
        let hz = f64::from(bin) / PERIOD_S;
        let (re, im) = (along.iter().zip(0..)).fold((0.0, 0.0), |(re, im), (x, k)| {
            let (sin, cos) = (TAU * hz * f64::from(k) * STEP_S).sin_cos();
            (re + x * cos, im + x * sin)
        });
        let amplitude = 2.0 * re.hypot(im) / samples;
        let expected = if LINES_HZ.contains(&hz) { RMS_M * (2.0_f64 / 7.0).sqrt() } else { 0.0 };
        assert!((amplitude - expected).abs() < TOLERANCE, "{amplitude} m for {expected} m at {hz} Hz");
    }
    let rms = (along.iter().map(|x| x * x).sum::<f64>() / samples).sqrt();
    assert!((rms - RMS_M).abs() < TOLERANCE, "{rms} m");
    let across = motion.iter().map(|offset| offset.cross(&axis).norm()).fold(0.0, f64::max);
    assert!(across < TOLERANCE, "{across} m across the axis");
}

/// Checks that two seeds differ, and that one seed is repeatable; and that a tremor is the same with and without a probe.
#[test]
fn phases_depend_on_the_seed() {
    let up = [0.0, 0.0, 1.0];
    assert_eq!(one_period(up, 5), one_period(up, 5));
    assert_ne!(one_period(up, 5), one_period(up, 6));
    let tremor = "motion.scripted.tremor = { rms_m = 3e-4, from_hz = 8.0, to_hz = 11.0 }";
    let (mut alone, mut with_probe) =
        (operator(1.0, 0.0, tremor, 5), operator(1.0, 0.0, &format!("{tremor}\n{}", probe(up)), 5));
    for t in [0.7, 3.9] {
        assert_eq!(alone(t), with_probe(t), "before the probe");
    }
    assert_ne!(alone(5.0), with_probe(5.0));
}

/// Checks that nothing moves before the probe begins, and that it begins smoothly. Compared: the force of the damper, and the
/// difference quotient of the offset.
#[test]
fn probe_begins_smoothly() {
    let axis = [1.0, 0.0, 0.0];
    let mut offset = operator(1.0, 0.0, &probe(axis), 5);
    assert_eq!(offset(FROM_S), Vector3::zeros());
    // A minimum-jerk ramp is at 10 u³ of its end at most: 1e-5 after a hundredth of its duration.
    assert!(offset(FROM_S + 0.005).norm() < 1e-5 * RMS_M * 14.0_f64.sqrt());
    let mut speed = operator(0.0, 1.0, &probe(axis), 5);
    for t in [FROM_S + 0.1, FROM_S + 0.4, FROM_S + 3.3] {
        let quotient = (offset(t + 1e-5) - offset(t - 1e-5)) / 2e-5;
        assert!((speed(t) - quotient).norm() < 1e-7, "{} m/s for {quotient} m/s at {t} s", speed(t));
    }
}
