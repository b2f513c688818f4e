//! Frequency responses from periodic records: H1, coherence, noise and nonlinear distortion.
//!
//! The setpoint is known exactly, so that `H1 = S_yu / S_uu` has no bias from input noise. Differences between periods
//! of one realisation are noise. Further differences between realisations are caused by the joint's nonlinearity, which
//! depends on the phases (R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, chapters 2
//! to 4).

use nalgebra::Complex;
use realfft::RealFftPlanner;
use serde::Serialize;

/// Realisation of the excitation, and the response to it.
#[derive(Clone, Debug, Default)]
pub struct Realisation {
    /// One period of the setpoint.
    pub input: Vec<f64>,
    /// Response, one vector per period.
    pub periods: Vec<Vec<f64>>,
}

/// Response at one excited frequency.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct Point {
    /// Frequency, Hz.
    pub hz: f64,
    /// Ratio of output to input, H1.
    #[serde(serialize_with = "complex")]
    pub value: Complex<f64>,
    /// γ²: fraction of the output's power that is linear in the input.
    pub coherence: f64,
    /// Standard deviation of `value` caused by noise.
    pub noise: f64,
}

/// Output that is not the linear response: ratios of its rms to the rms at the excited lines.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Distortion {
    /// Output at even lines, caused by even nonlinearities.
    pub even: f64,
    /// Output at odd lines that were not excited, caused by odd nonlinearities, mainly friction.
    pub odd: f64,
    /// Noise, over all lines.
    pub noise: f64,
}

impl Distortion {
    /// Even and odd nonlinearities together.
    #[must_use]
    pub fn total(&self) -> f64 {
        f64::hypot(self.even, self.odd)
    }
}

/// Serializes a complex number as [real, imaginary].
fn complex<S: serde::Serializer>(value: &Complex<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    [value.re, value.im].serialize(serializer)
}

/// Computes the response at `lines` from realisations sampled every `period_s` (s).
#[must_use]
pub fn frequency_response(realisations: &[Realisation], lines: &[usize], period_s: f64) -> Vec<Point> {
    let transformed: Vec<_> = realisations.iter().map(transform).collect();
    let samples = realisations.first().map_or(1, |r| r.input.len());
    let point = |&line: &usize| {
        let (mut uu, mut yy, mut noise, mut count) = (0.0, 0.0, 0.0, 0.0);
        let mut yu = Complex::new(0.0, 0.0);
        for (input, periods) in &transformed {
            let u = input[line];
            let mean = periods.iter().map(|p| p[line]).sum::<Complex<f64>>() / periods.len() as f64;
            for y in periods.iter().map(|p| p[line]) {
                uu += u.norm_sqr();
                yu += y * u.conj();
                yy += y.norm_sqr();
                noise += (y - mean).norm_sqr();
                count += 1.0;
            }
        }
        let degrees = (count - transformed.len() as f64).max(1.0);
        Point {
            hz: line as f64 / (samples as f64 * period_s),
            value: yu / uu,
            coherence: if yy > 0.0 { (yu.norm_sqr() / (uu * yy)).min(1.0) } else { 0.0 },
            noise: (noise / degrees / uu).sqrt(),
        }
    };
    lines.iter().map(point).collect()
}

/// Computes the distortion at lines up to the highest of `lines`.
#[must_use]
pub fn distortion(realisations: &[Realisation], lines: &[usize]) -> Distortion {
    let (mut linear, mut even, mut odd, mut noise) = (0.0, 0.0, 0.0, 0.0);
    let highest = lines.last().copied().unwrap_or(0);
    for (_, periods) in realisations.iter().map(transform) {
        let count = periods.len() as f64;
        for line in 1..=highest {
            let mean = periods.iter().map(|p| p[line]).sum::<Complex<f64>>() / count;
            let kind: &mut f64 = match (lines.contains(&line), line % 2) {
                (true, _) => &mut linear,
                (_, 0) => &mut even,
                _ => &mut odd,
            };
            *kind += mean.norm_sqr();
            let spread: f64 = periods.iter().map(|p| (p[line] - mean).norm_sqr()).sum();
            noise += spread / (count - 1.0).max(1.0) / count;
        }
    }
    // Total power of the distortion over total power at the excited lines.
    let share = |power: f64| (power / linear).sqrt();
    Distortion { even: share(even), odd: share(odd), noise: share(noise) }
}

type Spectrum = Vec<Complex<f64>>;

/// Transforms of the setpoint, and of each period of the response.
pub(crate) fn transform(realisation: &Realisation) -> (Spectrum, Vec<Spectrum>) {
    let mut planner = RealFftPlanner::<f64>::new();
    let plan = planner.plan_fft_forward(realisation.input.len());
    let spectrum = |samples: &[f64]| {
        let mut samples = samples.to_vec();
        let mut out = plan.make_output_vec();
        // It fails only for another length; the spectrum is then all zero.
        let _ = plan.process(&mut samples, &mut out);
        out.into_iter().map(|c| Complex::new(c.re, c.im)).collect()
    };
    (spectrum(&realisation.input), realisation.periods.iter().map(|p| spectrum(p)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::excitation::{Multisine, odd_lines};
    use std::f64::consts::TAU;

    const SAMPLES: usize = 512;
    const PERIOD_S: f64 = 1e-3;
    const POLE: f64 = 0.9;

    /// Returns the settled response of a first-order filter, plus `bend` times the cube of the setpoint, to a
    /// multisine.
    fn filtered(seed: u64, bend: f64) -> (Vec<usize>, Realisation) {
        let lines = odd_lines(1, 200, 10.0);
        let multisine = Multisine::new(&lines, SAMPLES, seed);
        let (mut y, mut periods) = (0.0, Vec::new());
        for _ in 0..4 {
            let mut period = Vec::new();
            for u in &multisine.samples {
                period.push(y + bend * u.powi(3));
                y += (1.0 - POLE) * (u - y);
            }
            periods.push(period);
        }
        periods.remove(0);
        (lines, Realisation { input: multisine.samples, periods })
    }

    /// Compares the estimate with the filter's transfer function (1 − p) z⁻¹ / (1 − p z⁻¹).
    #[test]
    fn filter_transfer_function_is_estimated() {
        const TOLERANCE: f64 = 1e-9;
        let (lines, one) = filtered(1, 0.0);
        let points = frequency_response(&[one, filtered(2, 0.0).1], &lines, PERIOD_S);
        for point in points {
            let back = Complex::from_polar(1.0, -TAU * point.hz * PERIOD_S);
            let expected = back * (1.0 - POLE) / (Complex::new(1.0, 0.0) - back * POLE);
            assert!((point.value - expected).norm() < TOLERANCE, "{} Hz", point.hz);
            assert!((point.coherence - 1.0).abs() < TOLERANCE);
            assert!(point.noise < TOLERANCE);
        }
    }

    #[test]
    fn cubic_distortion_appears_at_unexcited_odd_lines() {
        // Largest distortion by rounding, and smallest distortion by a cubic term of 2 %.
        const NOTHING: f64 = 1e-6;
        const SEEN: f64 = 1e-3;
        let (lines, straight) = filtered(1, 0.0);
        let bent = [filtered(1, 0.02).1, filtered(2, 0.02).1, filtered(3, 0.02).1];
        let (none, some) = (distortion(&[straight], &lines), distortion(&bent, &lines));
        assert!(none.total() < NOTHING, "{none:?}");
        assert!(some.odd > SEEN && some.even < NOTHING && some.noise < NOTHING, "{some:?}");
        let worst = |r: &[Realisation]| {
            frequency_response(r, &lines, PERIOD_S).iter().map(|p| p.coherence).fold(1.0, f64::min)
        };
        assert!(worst(&bent) < 1.0 - SEEN);
    }
}
