//! Response at lines that are not excited: noise, steps of the encoder, and distortion by friction.
//!
//! The steps of an encoder repeat with the motion in every period. Differences between periods do not show them; lines that
//! are not excited do.

use crate::response::{Realisation, transform};
use nalgebra::Complex;

/// Largest distance of the lines that stand for an excited one, in the logarithm of the frequency.
const NEAR: f64 = 0.15;

/// Smallest number of such lines.
const LINES: usize = 6;

/// Position and torque of each realisation, transformed, at a line that is not excited.
#[derive(Clone, Debug)]
struct Line {
    number: usize,
    hz: f64,
    values: Vec<[Complex<f64>; 2]>,
}

/// Positions and torques at the lines that an excitation leaves out.
#[derive(Clone, Debug)]
pub(crate) struct Background {
    lines: Vec<Line>,
    /// Number of each excited line, and the sum over the realisations of the squared amplitude of the setpoint there.
    excited: Vec<(usize, f64)>,
}

/// Covariances, at an excited line, of an error per unit of setpoint and of the position response.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Covariance {
    /// Variance of the error.
    pub error: f64,
    /// Mean product of the position and the conjugate of the error.
    pub position_error: Complex<f64>,
}

impl Background {
    /// Returns the background of realisations sampled every `period_s` (s), excited at `lines` (ascending).
    pub fn new(
        position: &[Realisation],
        torque: &[Realisation],
        lines: &[usize],
        period_s: f64,
    ) -> Option<Self> {
        let (position, torque): (Vec<_>, Vec<_>) =
            (position.iter().map(transform).collect(), torque.iter().map(transform).collect());
        let mean = |periods: &[Vec<Complex<f64>>], line: usize| {
            periods.iter().map(|p| p[line]).sum::<Complex<f64>>() / periods.len() as f64
        };
        let samples = 1.0 / period_s;
        let highest = *lines.last()?;
        let all = 2 * position.first()?.0.len().saturating_sub(1);
        let values = |line: usize| {
            position.iter().zip(&torque).map(|(p, t)| [mean(&p.1, line), mean(&t.1, line)]).collect()
        };
        let left_out = (1..=highest).filter(|line| lines.binary_search(line).is_err());
        let background = Self {
            lines: left_out
                .map(|number| Line {
                    number,
                    hz: number as f64 / all as f64 * samples,
                    values: values(number),
                })
                .collect(),
            excited: lines
                .iter()
                .map(|&line| (line, position.iter().map(|(input, _)| input[line].norm_sqr()).sum()))
                .collect(),
        };
        (!torque.is_empty() && background.lines.len() >= LINES).then_some(background)
    }

    /// Returns the covariances at each excited line of the error `error(hz, position, torque)`, which is linear in position
    /// and torque; `None` if that is `None` at a line.
    pub fn covariances(&self, error: impl Fn(f64) -> Option<[Complex<f64>; 2]>) -> Option<Vec<Covariance>> {
        let mut products = Vec::with_capacity(self.lines.len());
        for line in &self.lines {
            let [of_position, of_torque] = error(line.hz)?;
            let mut sum = Covariance::default();
            for [position, torque] in &line.values {
                let error = of_position * position + of_torque * torque;
                sum.error += error.norm_sqr();
                sum.position_error += position * error.conj();
            }
            products.push(sum);
        }
        let realisations = self.lines.first()?.values.len() as f64;
        let at = |&(number, power): &(usize, f64)| {
            let near = self.near(number);
            let scale = 1.0 / (near.len() as f64 * realisations * power);
            products[near].iter().fold(Covariance::default(), |sum, one| Covariance {
                error: sum.error + one.error * scale,
                position_error: sum.position_error + one.position_error * scale,
            })
        };
        Some(self.excited.iter().map(at).collect())
    }

    /// Indices of the lines that stand for the excited line of this number.
    fn near(&self, number: usize) -> std::ops::Range<usize> {
        let distance = |line: &Line| (line.number as f64 / number as f64).ln().abs();
        let above = self.lines.partition_point(|line| line.number < number);
        let (mut from, mut to) = (above, above);
        loop {
            let below = from.checked_sub(1).map(|at| (distance(&self.lines[at]), at));
            let next = self.lines.get(to).map(distance);
            let is_below = match (below, next) {
                (None, None) => break,
                (Some((one, _)), Some(other)) => one <= other,
                (below, None) => below.is_some(),
                (None, _) => false,
            };
            let nearest = if is_below { below.map_or(0.0, |(d, _)| d) } else { next.unwrap_or(0.0) };
            if to - from >= LINES && nearest > NEAR {
                break;
            }
            if is_below {
                from -= 1;
            } else {
                to += 1;
            }
        }
        from..to
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::excitation::{Multisine, odd_lines};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::slice::from_ref;

    const SAMPLES: usize = 1000;
    const PERIOD_S: f64 = 1e-3;

    /// Compares the covariances of an error with those of the noise that is added to positions, the same in each period.
    #[test]
    fn covariances_are_those_of_noise_that_repeats_in_each_period() {
        const TOLERANCE: f64 = 0.25;
        const AMPLITUDE: f64 = 0.3;
        let lines = odd_lines(1, 400, 14.0);
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let (mut position, mut torque) = (Vec::new(), Vec::new());
        for seed in 0..4 {
            let input = Multisine::new(&lines, SAMPLES, seed).samples;
            let noise: Vec<f64> = input.iter().map(|_| random.random_range(-AMPLITUDE..AMPLITUDE)).collect();
            let noisy: Vec<f64> = input.iter().zip(&noise).map(|(u, noise)| u + noise).collect();
            let of = |values: &[f64]| Realisation { input: input.clone(), periods: vec![values.to_vec(); 2] };
            position.push(of(&noisy));
            torque.push(of(&input));
        }
        let background = Background::new(&position, &torque, &lines, PERIOD_S).expect("lines left out");
        // The error is twice the position minus twice the torque: twice the noise.
        let error = |_hz: f64| Some([Complex::from(2.0), Complex::from(-2.0)]);
        let found = background.covariances(error).expect("an error");
        let of_noise = SAMPLES as f64 * AMPLITUDE * AMPLITUDE / 3.0;
        for (&(line, power), covariance) in background.excited.iter().zip(&found) {
            // A few lines stand for a low one.
            if line > 100 {
                let expected = of_noise / power;
                let (error, product) = (covariance.error / expected, covariance.position_error / expected);
                assert!((error / 4.0 - 1.0).abs() < TOLERANCE, "line {line}: {error}");
                assert!((product / 2.0 - 1.0).norm() < TOLERANCE, "line {line}: {product}");
            }
        }
        assert!(background.covariances(|_hz| None).is_none());
    }

    /// Checks that lines on both sides stand for an excited one, and none that is excited.
    #[test]
    fn nearest_lines_that_are_left_out_are_used() {
        let lines = [5, 7, 31];
        let one = Realisation { input: vec![1.0; 80], periods: vec![vec![0.0; 80]] };
        let background = Background::new(from_ref(&one), from_ref(&one), &lines, PERIOD_S).expect("lines");
        let numbers = |line: usize| -> Vec<usize> {
            background.lines[background.near(line)].iter().map(|line| line.number).collect()
        };
        assert_eq!(numbers(5), [3, 4, 6, 8, 9, 10]);
        assert_eq!(numbers(31), [25, 26, 27, 28, 29, 30]);
        assert!(Background::new(from_ref(&one), &[], &lines, PERIOD_S).is_none(), "no torque");
    }
}
