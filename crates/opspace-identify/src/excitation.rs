//! Odd random-phase multisines for the excitation of a joint.
//!
//! Lines are odd multiples of the inverse period, evenly spaced on a logarithmic frequency axis. Even nonlinearities
//! produce output at even lines, odd ones (friction) also at odd lines that are not excited. Both are thus detected,
//! and do not appear as a bias of the linear response that depends on the phases.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Number of draws of the phases; the draw with the lowest peak is used.
const DRAWS: usize = 12;

/// One period of a periodic setpoint, sampled at the interface rate.
#[derive(Clone, Debug)]
pub struct Multisine {
    /// Excited lines: numbers of cycles per period of the signal, odd and ascending.
    pub lines: Vec<usize>,
    /// Samples of one period, with an rms of 1.
    pub samples: Vec<f64>,
}

impl Multisine {
    /// Returns a multisine whose amplitudes are proportional to the inverse frequency. Each line has the same speed
    /// amplitude; position amplitudes are small at high frequencies, where motion mainly requires torque. `samples` is
    /// the number of interface cycles per period.
    #[must_use]
    pub fn new(lines: &[usize], samples: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = || {
            let phases: Vec<f64> = lines.iter().map(|_| random.random_range(0.0..TAU)).collect();
            signal(lines, &phases, samples)
        };
        let mut best = draw();
        for _ in 1..DRAWS {
            let other = draw();
            if peak(&other) < peak(&best) {
                best = other;
            }
        }
        Self { lines: lines.to_vec(), samples: best }
    }

    /// Crest factor: ratio of peak to rms.
    #[must_use]
    pub fn crest(&self) -> f64 {
        peak(&self.samples)
    }

    /// Largest change per interface cycle.
    #[must_use]
    pub fn steepest(&self) -> f64 {
        let next = self.samples.iter().cycle().skip(1);
        self.samples.iter().zip(next).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max)
    }

    /// Value at an interface cycle; the signal is periodic.
    #[must_use]
    pub fn at(&self, tick: usize) -> f64 {
        self.samples[tick % self.samples.len()]
    }
}

/// Returns odd lines from `lowest` to `highest`, about `per_decade` per decade if there are enough. Above the first few
/// lines, at least one odd line between any two is left out.
#[must_use]
pub fn odd_lines(lowest: usize, highest: usize, per_decade: f64) -> Vec<usize> {
    let odd = |x: f64| 2 * ((x - 1.0) / 2.0).round().max(0.0) as usize + 1;
    let step = 10f64.powf(1.0 / per_decade);
    let mut lines = Vec::new();
    let mut at = lowest.max(1) as f64;
    while odd(at) <= highest {
        let line = odd(at);
        if lines.last().is_none_or(|&last| line > last) {
            lines.push(line);
        }
        at *= step;
    }
    lines
}

fn signal(lines: &[usize], phases: &[f64], samples: usize) -> Vec<f64> {
    let turn = TAU / samples as f64;
    let power: f64 = lines.iter().map(|&l| 0.5 / (l * l) as f64).sum();
    let value = |k: usize| -> f64 {
        let waves = lines.iter().zip(phases);
        // The product is reduced modulo the period in integers, so that high lines keep their precision.
        waves.map(|(&l, phase)| (turn * ((l * k) % samples) as f64 + phase).cos() / l as f64).sum()
    };
    (0..samples).map(|k| value(k) / power.sqrt()).collect()
}

fn peak(samples: &[f64]) -> f64 {
    samples.iter().fold(0.0, |most, v| v.abs().max(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLES: usize = 400;

    fn excitation(seed: u64) -> Multisine {
        Multisine::new(&odd_lines(1, 160, 12.0), SAMPLES, seed)
    }

    /// Compares the discrete Fourier sum of the samples at every line with the requested amplitude.
    #[test]
    fn only_requested_odd_lines_are_excited() {
        const TOLERANCE: f64 = 1e-9;
        let multisine = excitation(3);
        assert!(multisine.lines.iter().all(|l| l % 2 == 1));
        let amplitude = |line: usize| {
            let (mut c, mut s) = (0.0, 0.0);
            for (k, v) in multisine.samples.iter().enumerate() {
                let angle = TAU * ((line * k) % SAMPLES) as f64 / SAMPLES as f64;
                c += v * angle.cos();
                s += v * angle.sin();
            }
            2.0 * f64::hypot(c, s) / SAMPLES as f64
        };
        let first = amplitude(1);
        for line in 0..SAMPLES / 2 {
            let expected = if multisine.lines.contains(&line) { first / line as f64 } else { 0.0 };
            assert!((amplitude(line) - expected).abs() < TOLERANCE, "line {line}");
        }
    }

    #[test]
    fn rms_is_one_and_peaks_are_low() {
        const TOLERANCE: f64 = 1e-9;
        // Bound for a dozen draws of some thirty sines; a Gaussian signal of 400 samples would reach 3.
        const CREST: f64 = 2.8;
        for seed in 0..5 {
            let multisine = excitation(seed);
            let power: f64 = multisine.samples.iter().map(|v| v * v).sum::<f64>() / SAMPLES as f64;
            assert!((power - 1.0).abs() < TOLERANCE);
            assert!(multisine.crest() < CREST, "{}", multisine.crest());
        }
    }

    #[test]
    fn realisations_differ_only_in_phases() {
        let (one, other) = (excitation(1), excitation(2));
        assert_eq!(one.lines, other.lines);
        assert_ne!(one.samples, other.samples);
        assert_eq!(one.samples, excitation(1).samples, "the same seed, the same signal");
    }

    #[test]
    fn lines_are_spread_evenly_over_decades() {
        let lines = odd_lines(1, 799, 12.0);
        assert!(lines.windows(2).all(|w| w[0] < w[1]) && lines.iter().all(|l| l % 2 == 1 && *l <= 799));
        let within = |from, to| lines.iter().filter(|&&l| l >= from && l < to).count();
        assert!((10..=13).contains(&within(30, 300)), "{lines:?}");
        assert!(within(20, 800) < (800 - 20) / 4, "odd lines are left out");
    }
}
