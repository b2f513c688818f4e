//! Chatter: the part of a signal above a frequency, by its spectrum.

use crate::evaluate::spectrum::{hann, windowed_transform};
use realfft::RealFftPlanner;

/// Frequency above which a desired torque is chatter, Hz: motions of tasks and of an operator are slower.
pub(super) const CHATTER_HZ: f64 = 8.0;

/// The part of a signal above [`CHATTER_HZ`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chatter {
    /// Rms of that part, in the unit of the signal.
    pub rms: f64,
    /// Frequency of its largest line, Hz.
    pub largest_hz: f64,
}

impl Chatter {
    /// Analyses samples at a rate (Hz), with a Hann window; `None` if they are too few, or one is not finite. `planner`
    /// keeps the plan of the transform for signals of the same length.
    pub fn of(samples: &[f64], rate_hz: f64, planner: &mut RealFftPlanner<f64>) -> Option<Self> {
        let n = samples.len();
        let spectrum = windowed_transform(samples, planner)?;
        let power: f64 = (0..n).map(|k| hann(k, n).powi(2)).sum();
        let line_hz = rate_hz / n as f64;
        // One-sided: every line but those at 0 and at half the rate stands for two.
        let weight = |line: usize| if 2 * line == n { 1.0 } else { 2.0 };
        let above = spectrum.iter().enumerate().filter(|(line, _)| *line as f64 * line_hz >= CHATTER_HZ);
        let squares = above.map(|(line, value)| (line, weight(line) * value.norm_sqr()));
        let (mut sum, mut largest) = (0.0, (0, 0.0));
        for (line, square) in squares {
            sum += square;
            if square > largest.1 {
                largest = (line, square);
            }
        }
        Some(Self { rms: (sum / (n as f64 * power)).sqrt(), largest_hz: largest.0 as f64 * line_hz })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Relative error of the rms of a line: its side lobes within the window.
    const LEAKAGE: f64 = 1e-3;

    /// Compared: the rms and the frequency of the faster of two sine waves, with a constant, and those found.
    #[test]
    fn chatter_is_that_of_the_fast_wave() {
        let rate_hz = 1000.0;
        let samples: Vec<f64> = (0..6501)
            .map(|k| f64::from(k) / rate_hz)
            .map(|t| 20.0 + 5.0 * (TAU * 0.7 * t).sin() + 0.8 * (TAU * 15.3 * t).sin())
            .collect();
        let mut planner = RealFftPlanner::new();
        let found = Chatter::of(&samples, rate_hz, &mut planner).expect("a spectrum");
        assert!((found.rms / (0.8 / 2f64.sqrt()) - 1.0).abs() < LEAKAGE, "{found:?}");
        assert!((found.largest_hz - 15.3).abs() <= rate_hz / samples.len() as f64, "{found:?}");
        assert_eq!(Chatter::of(&samples[..20], rate_hz, &mut planner), None);
        assert_eq!(Chatter::of(&[f64::NAN; 100], rate_hz, &mut planner), None);
    }
}
