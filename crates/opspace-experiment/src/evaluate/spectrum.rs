//! Discrete Fourier transform of a signal with a Hann window.

use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Least number of samples of a spectrum.
const MIN_SAMPLES: usize = 64;

/// Weight of sample `k` of `n`; the mean of the weights is one half.
pub(crate) fn hann(k: usize, n: usize) -> f64 {
    0.5 - 0.5 * (TAU * k as f64 / n as f64).cos()
}

/// Transforms samples minus their mean, weighted by the window; line `k` has the frequency k/n of the sampling rate.
/// `None` if they are too few, or one is not finite. `planner` keeps the plan for signals of the same length.
pub(crate) fn windowed_transform(
    samples: &[f64],
    planner: &mut RealFftPlanner<f64>,
) -> Option<Vec<Complex<f64>>> {
    let n = samples.len();
    if n < MIN_SAMPLES || samples.iter().any(|sample| !sample.is_finite()) {
        return None;
    }
    let mean = samples.iter().sum::<f64>() / n as f64;
    let mut windowed: Vec<f64> = samples.iter().enumerate().map(|(k, s)| hann(k, n) * (s - mean)).collect();
    let transform = planner.plan_fft_forward(n);
    let mut lines = transform.make_output_vec();
    transform.process(&mut windowed, &mut lines).ok()?;
    Some(lines)
}
