//! Sum of sines over time, evaluated at steps of constant length by rotation.

/// Number of sines of a sum.
pub(crate) const SINES: usize = 24;

/// Number of rotations after which the sines are computed anew: rounding does not accumulate beyond it.
const MAX_ROTATIONS: u32 = 256;

/// Relative difference of two steps that are the same but for rounding of the times.
const SAME_STEP: f64 = 1e-9;

/// Sum of sines, `Σ a sin(ω t + φ)`. While time advances by equal steps, each sine is rotated by its angle per step, which
/// takes a tenth of the time of a sine.
#[derive(Clone, Debug)]
pub(crate) struct Sines {
    amplitude: [f64; SINES],
    omega: [f64; SINES],
    phase: [f64; SINES],
    /// Sines and cosines at `time_s`.
    sin: [f64; SINES],
    cos: [f64; SINES],
    /// Sines and cosines of the angles of a step.
    step_sin: [f64; SINES],
    step_cos: [f64; SINES],
    time_s: f64,
    step_s: f64,
    rotations: u32,
}

impl Default for Sines {
    fn default() -> Self {
        Self::new(&[(0.0, 0.0, 0.0); SINES])
    }
}

impl Sines {
    /// Returns the sum of sines of these amplitudes, angular frequencies (rad/s) and phases (rad).
    pub fn new(sines: &[(f64, f64, f64); SINES]) -> Self {
        let zero = [0.0; SINES];
        Self {
            amplitude: sines.map(|s| s.0),
            omega: sines.map(|s| s.1),
            phase: sines.map(|s| s.2),
            sin: zero,
            cos: zero,
            step_sin: zero,
            step_cos: zero,
            time_s: f64::NAN,
            step_s: f64::NAN,
            rotations: 0,
        }
    }

    /// Returns the sum at a time (s), and its derivative (1/s).
    pub fn at(&mut self, time_s: f64) -> (f64, f64) {
        let step_s = time_s - self.time_s;
        let is_same_step = (step_s - self.step_s).abs() <= SAME_STEP * self.step_s.abs();
        if is_same_step && self.rotations < MAX_ROTATIONS {
            self.rotate();
        } else {
            self.compute(time_s, step_s, is_same_step);
        }
        self.time_s = time_s;
        let (mut sum, mut rate) = (0.0, 0.0);
        for i in 0..SINES {
            sum += self.amplitude[i] * self.sin[i];
            rate += self.amplitude[i] * self.omega[i] * self.cos[i];
        }
        (sum, rate)
    }

    fn rotate(&mut self) {
        self.rotations += 1;
        for i in 0..SINES {
            let (sin, cos) = (self.sin[i], self.cos[i]);
            self.sin[i] = sin * self.step_cos[i] + cos * self.step_sin[i];
            self.cos[i] = cos * self.step_cos[i] - sin * self.step_sin[i];
        }
    }

    fn compute(&mut self, time_s: f64, step_s: f64, is_same_step: bool) {
        self.rotations = 0;
        for i in 0..SINES {
            (self.sin[i], self.cos[i]) = (self.omega[i] * time_s + self.phase[i]).sin_cos();
        }
        if !is_same_step {
            self.step_s = step_s;
            for i in 0..SINES {
                (self.step_sin[i], self.step_cos[i]) = (self.omega[i] * step_s).sin_cos();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Compared: sum and derivative at steps of 50 µs, at steps of another length after them and at single times, and
    /// those computed by sines.
    #[test]
    fn rotated_sines_are_the_sines() {
        /// Rounding of 256 rotations, relative to the sum of the amplitudes.
        const TOLERANCE: f64 = 1e-12;
        let sines: [(f64, f64, f64); SINES] = std::array::from_fn(|i| {
            let i = i as f64;
            (0.1 + 0.01 * i, TAU * (0.1 + 0.3 * i), 0.7 * i)
        });
        let mut rotated = Sines::new(&sines);
        let steps = (0..5000).map(|k| -0.2 + f64::from(k) * 5e-5);
        let longer = (0..600).map(|k| 0.05 + f64::from(k) * 2e-4);
        for t in steps.chain(longer).chain([7.0, 3.0, 3.0]) {
            let exact = sines.iter().fold((0.0, 0.0), |(sum, rate), (a, w, p)| {
                (sum + a * (w * t + p).sin(), rate + a * w * (w * t + p).cos())
            });
            let found = rotated.at(t);
            let scale = 6.0;
            assert!((found.0 - exact.0).abs() < TOLERANCE * scale, "at {t} s: {found:?}, {exact:?}");
            assert!(
                (found.1 - exact.1).abs() < TOLERANCE * scale * TAU * 7.0,
                "at {t} s: {found:?}, {exact:?}"
            );
        }
    }
}
