//! First-order low-pass filter.

use std::f64::consts::TAU;

/// Returns the gain a of `y += a (x − y)`, a first-order low-pass filter with its −3 dB point at `cutoff_hz` and a
/// sampling period of `period_s`: a = 1 − exp(−2π f T), exact for an input that is constant over each period.
#[must_use]
pub fn gain(cutoff_hz: f64, period_s: f64) -> f64 {
    1.0 - (-TAU * cutoff_hz * period_s).exp()
}

/// First-order low-pass filter of N channels: `y += a (x − y)` with the [`gain`] a.
#[derive(Clone, Debug)]
pub struct LowPass<const N: usize> {
    gain: f64,
    state: [f64; N],
}

impl<const N: usize> LowPass<N> {
    /// Returns a filter with its −3 dB point at `cutoff_hz` (Hz) and a sampling period of `period_s` (s). Its output is
    /// zero.
    #[must_use]
    pub fn new(cutoff_hz: f64, period_s: f64) -> Self {
        Self { gain: gain(cutoff_hz, period_s), state: [0.0; N] }
    }

    /// Sets the output of each channel to its `input`; channels with an input that is not finite are unchanged.
    pub fn reset(&mut self, input: &[f64; N]) {
        for (y, &x) in self.state.iter_mut().zip(input).filter(|(_, x)| x.is_finite()) {
            *y = x;
        }
    }

    /// Returns the output after one more period. A channel with an input that is not finite returns a non-finite output
    /// and keeps its state.
    pub fn update(&mut self, input: &[f64; N]) -> [f64; N] {
        let mut output = self.state;
        for (y, x) in output.iter_mut().zip(input) {
            *y += self.gain * (x - *y);
        }
        self.reset(&output);
        output
    }

    /// Returns the last finite output of each channel.
    #[must_use]
    pub fn output(&self) -> &[f64; N] {
        &self.state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: the step response after k periods, and that of the continuous filter, 1 − exp(−2π f k T).
    #[test]
    fn step_response_matches_continuous_filter() {
        let (cutoff_hz, period_s) = (100.0, 1e-3);
        let mut filter = LowPass::<1>::new(cutoff_hz, period_s);
        for k in 1..=20 {
            let [y] = filter.update(&[1.0]);
            let exact = 1.0 - (-TAU * cutoff_hz * period_s * f64::from(k)).exp();
            assert!((y - exact).abs() < 16.0 * f64::EPSILON, "after {k} periods: {y} against {exact}");
        }
    }

    /// Compared: outputs of a filter that receives a non-finite input at the start or later, and of a filter that never
    /// receives it.
    #[test]
    fn non_finite_input_is_passed_on_and_forgotten() {
        for broken in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (mut filter, mut other) = (LowPass::<2>::new(100.0, 1e-3), LowPass::<1>::new(100.0, 1e-3));
            filter.reset(&[broken, broken]);
            assert_eq!(filter.output(), &[0.0, 0.0]);
            for input in [1.0, 2.0, broken, 3.0, 4.0] {
                let [y, x] = filter.update(&[input, 5.0]);
                assert!(x.is_finite(), "the other channel goes on");
                if input.is_finite() {
                    assert_eq!([y], other.update(&[input]));
                } else {
                    assert!(!y.is_finite(), "{y} for {input}");
                }
            }
        }
    }
}
