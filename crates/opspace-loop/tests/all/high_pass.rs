//! Tests of the high pass.

use opspace_loop::high_pass::HighPass;
use std::f64::consts::{PI, SQRT_2, TAU};

const CORNER_HZ: f64 = 15.0;
const RATES_HZ: [f64; 5] = [1000.0, 500.0, 250.0, 125.0, 50.0];
/// Time after which the filter has settled, s.
const SETTLED_S: f64 = 3.0;
/// Duration of the output that is compared, s: whole periods of all frequencies.
const COMPARED_S: f64 = 1.0;
/// Rest of the transient after [`SETTLED_S`], and rounding.
const SETTLING: f64 = 1e-12;

/// Gain of the analog filter at the frequency that the bilinear transform maps to `frequency_hz` (Hz).
fn expected_gain(frequency_hz: f64, rate_hz: f64) -> f64 {
    let warped = |f: f64| (PI * f / rate_hz).tan();
    1.0 / (1.0 + (warped(CORNER_HZ) / warped(frequency_hz)).powi(8)).sqrt()
}

/// Compared: the rms of the output for a cosine, and the magnitude of the transfer function by its formula.
#[test]
fn gain_is_that_of_a_butterworth_filter() {
    for rate_hz in RATES_HZ {
        for frequency_hz in [1.0, 5.0, 10.0, CORNER_HZ, 24.0] {
            let mut filter = HighPass::new(CORNER_HZ, 1.0 / rate_hz).expect("a filter");
            let samples = (rate_hz * (SETTLED_S + COMPARED_S)).round() as usize;
            let output: Vec<f64> = (0..samples)
                .map(|k| filter.update((TAU * frequency_hz * k as f64 / rate_hz).cos()))
                .skip((rate_hz * SETTLED_S) as usize)
                .collect();
            let rms = (output.iter().map(|y| y * y).sum::<f64>() / output.len() as f64).sqrt();
            let difference = rms * SQRT_2 - expected_gain(frequency_hz, rate_hz);
            assert!(difference.abs() < SETTLING, "{frequency_hz} Hz at {rate_hz} Hz: {difference}");
        }
    }
}

/// Checks that an alternating signal, at half the sampling rate, passes unchanged, and a constant one not at all.
#[test]
fn alternating_signal_passes_and_constant_does_not() {
    for rate_hz in RATES_HZ {
        let mut filters =
            [1.0, -1.0].map(|sign| (HighPass::new(CORNER_HZ, 1.0 / rate_hz).expect("a filter"), sign));
        let last = (rate_hz * SETTLED_S) as i32;
        let outputs = filters.each_mut().map(|(filter, sign): &mut (HighPass, f64)| {
            (0..=last).map(|k| filter.update(sign.powi(k))).last().expect("samples")
        });
        assert!(outputs[0].abs() < SETTLING, "{} at {rate_hz} Hz", outputs[0]);
        assert!((outputs[1] - (-1.0_f64).powi(last)).abs() < SETTLING, "{} at {rate_hz} Hz", outputs[1]);
    }
}

/// Checks that a reset brings the filter to rest, and that a corner frequency which is not sampled is refused.
#[test]
fn reset_and_limits_of_the_corner_frequency() {
    let new = HighPass::new(CORNER_HZ, 1e-3).expect("a filter");
    let mut used = new.clone();
    assert!(used.update(1.0) > 0.5);
    used.reset();
    assert_eq!(used, new);
    for (corner_hz, rate_hz) in [(CORNER_HZ, 30.0), (CORNER_HZ, 20.0), (0.0, 1000.0), (f64::NAN, 1000.0)] {
        assert_eq!(HighPass::new(corner_hz, 1.0 / rate_hz), None, "{corner_hz} Hz at {rate_hz} Hz");
    }
}
