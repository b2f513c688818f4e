//! Spectrum of a signal of any length: the mean over blocks with a Hann window that overlap by half (P. D. Welch, 1967).

use realfft::{RealFftPlanner, RealToComplex};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Least number of samples of a spectrum.
const MIN_SAMPLES: usize = 64;

/// Spectrum that is estimated while samples arrive. Every sample is in a block: the last block overlaps more.
pub struct Welch {
    block: usize,
    transform: Arc<dyn RealToComplex<f64>>,
    /// Samples from the beginning of the last block on.
    samples: Vec<f64>,
    /// True if the last samples are in no block yet.
    is_open: bool,
    /// Sum over the blocks of the squared magnitude of each line.
    squares: Vec<f64>,
    blocks: u64,
    is_finite: bool,
}

/// Spectrum of a signal; line `k` has the frequency k/n of the sampling rate.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    /// Number of samples of a block.
    pub n: usize,
    /// Squared magnitude of each line of the transform of a windowed block, mean over the blocks.
    pub squares: Vec<f64>,
}

impl Welch {
    /// Returns a spectrum without samples. Blocks have `block` samples; a shorter signal is one block.
    pub fn new(block: usize, planner: &mut RealFftPlanner<f64>) -> Self {
        let block = block.max(MIN_SAMPLES);
        Self {
            block,
            transform: planner.plan_fft_forward(block),
            samples: Vec::new(),
            is_open: false,
            squares: Vec::new(),
            blocks: 0,
            is_finite: true,
        }
    }

    /// Adds the next sample.
    pub fn add(&mut self, sample: f64) {
        self.is_finite &= sample.is_finite();
        self.samples.push(sample);
        self.is_open = true;
        let begin = if self.blocks == 0 { 0 } else { self.block.div_ceil(2) };
        if self.samples.len() == begin + self.block {
            self.samples.drain(..begin);
            self.close_block();
        }
    }

    /// Returns the spectrum of all samples; `None` if they are too few, or one is not finite.
    pub fn finish(mut self) -> Option<Spectrum> {
        if self.samples.len() < MIN_SAMPLES || !self.is_finite {
            return None;
        }
        if self.blocks == 0 {
            self.block = self.samples.len();
            self.transform = RealFftPlanner::new().plan_fft_forward(self.block);
        }
        if self.is_open {
            self.samples.drain(..self.samples.len() - self.block);
            self.close_block();
        }
        let blocks = self.blocks as f64;
        Some(Spectrum { n: self.block, squares: self.squares.iter().map(|sum| sum / blocks).collect() })
    }

    /// Transforms the samples, which are one block, minus their mean and weighted by the window.
    fn close_block(&mut self) {
        let n = self.samples.len();
        let mean = self.samples.iter().sum::<f64>() / n as f64;
        let mut windowed: Vec<f64> =
            self.samples.iter().enumerate().map(|(k, sample)| hann(k, n) * (sample - mean)).collect();
        let mut lines = self.transform.make_output_vec();
        // It fails only for other lengths than those of the plan.
        self.is_finite &= self.transform.process(&mut windowed, &mut lines).is_ok();
        self.squares.resize(lines.len(), 0.0);
        self.squares.iter_mut().zip(&lines).for_each(|(sum, line)| *sum += line.norm_sqr());
        self.blocks += 1;
        self.is_open = false;
    }
}

impl Spectrum {
    /// Amplitude of the sine that each line stands for, rms over the blocks, from the first line above 0 on.
    pub fn amplitudes(&self) -> impl Iterator<Item = f64> {
        // The mean of the window is one half, and a line stands for two.
        self.squares.iter().skip(1).map(|square| 4.0 * square.sqrt() / self.n as f64)
    }

    /// Mean square of the part of the signal that each line stands for.
    pub fn mean_squares(&self) -> impl Iterator<Item = f64> {
        let n = self.n;
        let power: f64 = (0..n).map(|k| hann(k, n).powi(2)).sum();
        // One-sided: every line but those at 0 and at half the rate stands for two.
        let weight = move |line: usize| if line == 0 || 2 * line == n { 1.0 } else { 2.0 };
        self.squares.iter().enumerate().map(move |(line, square)| weight(line) * square / (n as f64 * power))
    }
}

/// Weight of sample `k` of `n`; the mean of the weights is one half.
fn hann(k: usize, n: usize) -> f64 {
    0.5 - 0.5 * (TAU * k as f64 / n as f64).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a transform of a thousand samples.
    const ROUNDING: f64 = 1e-9;

    fn spectrum(samples: &[f64], block: usize) -> Option<Spectrum> {
        let mut welch = Welch::new(block, &mut RealFftPlanner::new());
        samples.iter().for_each(|sample| welch.add(*sample));
        welch.finish()
    }

    /// Compared: the amplitudes at the frequencies of two sines, and these sines' amplitudes.
    #[test]
    fn spectrum_has_the_amplitudes_of_sines() {
        let samples: Vec<f64> = (0..5300)
            .map(|k| f64::from(k) * 1e-3)
            .map(|t| 7.0 + 0.5 * (TAU * 20.0 * t).sin() + 0.02 * (TAU * 310.0 * t).cos())
            .collect();
        let amplitudes: Vec<f64> = spectrum(&samples, 1000).expect("a spectrum").amplitudes().collect();
        assert!((amplitudes[19] - 0.5).abs() < ROUNDING && (amplitudes[309] - 0.02).abs() < ROUNDING);
        assert!(amplitudes[99] < ROUNDING, "{}", amplitudes[99]);
        assert_eq!(spectrum(&samples[..20], 1000), None);
        assert_eq!(spectrum(&[f64::NAN; 100], 1000), None);
    }

    /// Compared: the mean squares, summed over all lines, and the variance of noise, for lengths around those at which a
    /// block is complete. A burst in the last samples is seen too.
    #[test]
    fn every_sample_is_in_a_block() {
        let noise = |k: usize| ((k as f64 * 12.9898).sin() * 43758.5453).fract();
        for length in [64, 99, 100, 101, 149, 150, 151, 299, 300, 1033] {
            let mut samples: Vec<f64> = (0..length).map(noise).collect();
            let found = spectrum(&samples, 100).expect("a spectrum");
            assert_eq!(found.n, length.min(100));
            let total: f64 = found.mean_squares().sum();
            let mean = samples.iter().sum::<f64>() / length as f64;
            let variance = samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / length as f64;
            assert!((total / variance - 1.0).abs() < 0.5, "{length}: {total} for {variance}");
            samples[length - 20..].iter_mut().for_each(|s| *s *= 1000.0);
            let with_burst: f64 = spectrum(&samples, 100).expect("a spectrum").mean_squares().sum();
            assert!(with_burst > 100.0 * total, "{length}: {with_burst} for {total}");
        }
    }
}
