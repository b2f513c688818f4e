//! Frequency responses from periodic records: H1, coherence, noise and nonlinear distortion.
//!
//! The setpoint is known exactly, so that `H1 = S_yu / S_uu` has no bias from noise at the input. Differences between
//! periods of one realisation are noise; differences between realisations beyond that are the effect of other phases on
//! the joint's nonlinearity
//! (R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, chapters 2 to 4).

use nalgebra::Complex;
use realfft::RealFftPlanner;
use serde::Serialize;

/// Realisation of the excitation: one period of the setpoint, and each period of the response.
#[derive(Clone, Debug, Default)]
pub struct Realisation {
    /// One period of the setpoint.
    pub input: Vec<f64>,
    /// Response, period by period.
    pub periods: Vec<Vec<f64>>,
}

/// Response at an excited line.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct Point {
    /// Frequency, Hz.
    pub hz: f64,
    /// Output over input: H1.
    #[serde(serialize_with = "complex")]
    pub value: Complex<f64>,
    /// γ²: the share of the output's power that is linear in the input.
    pub coherence: f64,
    /// Standard deviation of `value` from noise.
    pub noise: f64,
}

/// Share of the output that is not the linear response, each rms over the rms at excited lines.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct Distortion {
    /// Share at even lines: even nonlinearities.
    pub even: f64,
    /// Share at odd lines that were not excited: odd nonlinearities, friction above all.
    pub odd: f64,
    /// Share of noise alone, rms over all lines.
    pub noise: f64,
}

impl Distortion {
    /// Share of even and odd nonlinearities together.
    #[must_use]
    pub fn total(&self) -> f64 {
        f64::hypot(self.even, self.odd)
    }
}

/// Serializes a complex number as [real, imaginary].
fn complex<S: serde::Serializer>(value: &Complex<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    [value.re, value.im].serialize(serializer)
}

/// Computes the response at `lines`, from realisations sampled every `period_s`.
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

/// Computes the output at lines that are not excited, up to the highest of `lines`.
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
    // All of the power that appears, against all that was put in: lines that are left out stand close together.
    let share = |power: f64| (power / linear).sqrt();
    Distortion { even: share(even), odd: share(odd), noise: share(noise) }
}

type Spectrum = Vec<Complex<f64>>;

fn transform(realisation: &Realisation) -> (Spectrum, Vec<Spectrum>) {
    let mut planner = RealFftPlanner::<f64>::new();
    let plan = planner.plan_fft_forward(realisation.input.len());
    let spectrum = |samples: &[f64]| {
        let mut samples = samples.to_vec();
        let mut out = plan.make_output_vec();
        // It fails only on other lengths than its own: the line is then all zero.
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

    /// Response of a joint that is a first-order filter, plus `bend` times the cube of the setpoint, to a multisine,
    /// once it has settled.
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
        // What rounding leaves of nothing, and what a cubic of 2 % can't stay below.
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
