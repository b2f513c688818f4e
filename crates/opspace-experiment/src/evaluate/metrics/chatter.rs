//! Chatter: the part of a signal above a frequency, by its spectrum.

use crate::evaluate::spectrum::Spectrum;

/// Frequency above which a desired torque is chatter, Hz: motions of tasks and of an operator are slower.
pub(super) const CHATTER_HZ: f64 = 8.0;

/// Duration of a block of the spectrum, s.
pub(super) const BLOCK_S: f64 = 4.0;

/// The part of a signal above [`CHATTER_HZ`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chatter {
    /// Rms of that part, in the unit of the signal.
    pub rms: f64,
    /// Frequency of its largest line, Hz; `None` if the spectrum only falls from the frequency on that begins the part.
    pub largest_hz: Option<f64>,
}

impl Chatter {
    /// Evaluates the spectrum of a signal that was sampled at a rate (Hz).
    pub fn of(spectrum: &Spectrum, rate_hz: f64) -> Self {
        let line_hz = rate_hz / spectrum.n as f64;
        let (mut sum, mut below, mut largest) = (0.0, 0.0, None::<(usize, f64)>);
        for (line, square) in spectrum.mean_squares().enumerate() {
            if line as f64 * line_hz < CHATTER_HZ {
                below = square;
                continue;
            }
            sum += square;
            if largest.is_none_or(|(_, least)| square > least) {
                largest = Some((line, square));
            }
        }
        // The first line can be the flank of a larger one below.
        let line = largest.filter(|(_, square)| *square > below);
        Self { rms: sum.sqrt(), largest_hz: line.map(|(line, _)| line as f64 * line_hz) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::spectrum::Welch;
    use realfft::RealFftPlanner;
    use std::f64::consts::TAU;

    /// Relative error of the rms of a line: its side lobes within the window.
    const LEAKAGE: f64 = 1e-3;

    /// Compared: the rms and the frequency of the faster of two sine waves, with a constant, and those found; over one
    /// block, and over several.
    #[test]
    fn chatter_is_that_of_the_fast_wave() {
        let rate_hz = 1000.0;
        for samples in [3500, 6501, 60_000] {
            let mut welch = Welch::new((BLOCK_S * rate_hz) as usize, &mut RealFftPlanner::new());
            (0..samples)
                .map(|k| f64::from(k) / rate_hz)
                .map(|t| 20.0 + 5.0 * (TAU * 0.7 * t).sin() + 0.8 * (TAU * 15.3 * t).sin())
                .for_each(|sample| welch.add(sample));
            let found = Chatter::of(&welch.finish().expect("a spectrum"), rate_hz);
            assert!((found.rms / (0.8 / 2f64.sqrt()) - 1.0).abs() < LEAKAGE, "{found:?}");
            assert!((found.largest_hz.expect("a line") - 15.3).abs() <= 1.0 / BLOCK_S, "{found:?}");
        }
    }

    /// Checks a wave just below the band, whose spectrum falls through the band's first line.
    #[test]
    fn flank_of_a_slower_wave_is_no_line() {
        let rate_hz = 1000.0;
        let mut welch = Welch::new((BLOCK_S * rate_hz) as usize, &mut RealFftPlanner::new());
        (0..8000).map(|k| (TAU * 7.7 * f64::from(k) / rate_hz).sin()).for_each(|sample| welch.add(sample));
        let found = Chatter::of(&welch.finish().expect("a spectrum"), rate_hz);
        assert!(found.rms > 0.0 && found.largest_hz.is_none(), "{found:?}");
    }
}
