//! Amplitudes and phases of a signal at given frequencies.

use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Part of a signal at one frequency: `cosine cos ωt + sine sin ωt`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Harmonics {
    cosine: f64,
    sine: f64,
}

impl Harmonics {
    pub(crate) fn amplitude(self) -> f64 {
        self.cosine.hypot(self.sine)
    }

    /// Phase of the complex amplitude, rad.
    pub(crate) fn phase_rad(self) -> f64 {
        (-self.sine).atan2(self.cosine)
    }
}

/// Fits a constant, a trend and all lines (Hz) to the samples (time in s, value) at once, by least squares: unlike a Fourier
/// transform, for any duration. `None` if there are too few samples, or lines that these cannot tell apart.
pub(crate) fn fit(samples: &[(f64, f64)], lines_hz: &[f64]) -> Option<Vec<Harmonics>> {
    let unknowns = 2 + 2 * lines_hz.len();
    if samples.len() < unknowns {
        return None;
    }
    let (mut normal, mut right) = (DMatrix::zeros(unknowns, unknowns), DVector::zeros(unknowns));
    let (first_s, last_s) = (samples.first()?.0, samples.last()?.0);
    let mut row = DVector::zeros(unknowns);
    for &(time_s, value) in samples {
        row[0] = 1.0;
        row[1] = (time_s - first_s) / (last_s - first_s);
        for (k, line) in lines_hz.iter().enumerate() {
            let (sine, cosine) = (TAU * line * time_s).sin_cos();
            row[2 + 2 * k] = cosine;
            row[3 + 2 * k] = sine;
        }
        normal.ger(1.0, &row, &row, 1.0);
        right.axpy(value, &row, 1.0);
    }
    let solution = normal.cholesky()?.solve(&right);
    let lines =
        (0..lines_hz.len()).map(|k| Harmonics { cosine: solution[2 + 2 * k], sine: solution[3 + 2 * k] });
    Some(lines.collect())
}

#[cfg(test)]
mod tests {
    use super::fit;
    use std::f64::consts::TAU;

    /// Compared: amplitudes and phases that are found, and those of the signal, which has an offset and a trend and does not
    /// end with a period. Tolerance: rounding.
    #[test]
    fn lines_of_a_known_signal_are_found() {
        let lines = [(0.5, 2.0, 0.3), (0.8, 0.5, -2.0), (1.25, 1.0, 1.5)];
        let signal = |t: f64| {
            3.0 - 0.7 * t + lines.iter().map(|(f, a, phase)| a * (TAU * f * t + phase).cos()).sum::<f64>()
        };
        let samples: Vec<(f64, f64)> =
            (0..3137).map(|k| f64::from(k) * 0.002 + 1.0).map(|t| (t, signal(t))).collect();
        let found = fit(&samples, &lines.map(|line| line.0)).expect("enough samples");
        for (found, (_, amplitude, phase)) in found.iter().zip(lines) {
            assert!((found.amplitude() - amplitude).abs() < 1e-10, "{found:?}");
            assert!((found.phase_rad() - phase).abs() < 1e-9, "{found:?}");
        }
        assert_eq!(fit(&samples[..5], &[1.0, 2.0]), None);
    }
}
