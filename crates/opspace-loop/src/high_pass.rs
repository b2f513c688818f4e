//! High pass of fourth order (Butterworth), which removes what is slower than its corner frequency f_c.
//!
//! ```text
//! |H(f)| = 1/√(1 + (f_c/f)⁸)
//! ```
//!
//! It passes 0.71 of an amplitude at f_c, 0.19 at two thirds of f_c, and 0.012 at a third. The bilinear transform keeps f_c. Near
//! half the sampling rate it makes the filter steeper.

use std::f64::consts::PI;

/// High pass of a sampled signal: two filters of second order in series.
#[derive(Clone, Debug, PartialEq)]
pub struct HighPass([SecondOrder; 2]);

/// High pass of second order.
#[derive(Clone, Debug, PartialEq)]
struct SecondOrder {
    gain: f64,
    a: [f64; 2],
    input: [f64; 2],
    output: [f64; 2],
}

impl HighPass {
    /// Returns a filter at rest, with samples every `period_s` (s). `None` if the corner frequency `corner_hz` (Hz) is not above
    /// zero and below half the sampling rate.
    #[must_use]
    pub fn new(corner_hz: f64, period_s: f64) -> Option<Self> {
        let w = (PI * corner_hz * period_s).tan();
        // Damping of the two pairs of poles: 2 cos(π/8) and 2 cos(3π/8).
        let filter = || Self([1.0, 3.0].map(|k| SecondOrder::new(w, 2.0 * (k * PI / 8.0).cos())));
        (corner_hz > 0.0 && corner_hz * period_s < 0.5).then(filter)
    }

    /// Returns the output for the next sample, in the unit of the sample.
    #[must_use]
    pub fn update(&mut self, x: f64) -> f64 {
        self.0.iter_mut().fold(x, |x, part| part.update(x))
    }

    /// Brings the filter to rest.
    pub fn reset(&mut self) {
        for part in &mut self.0 {
            (part.input, part.output) = ([0.0; 2], [0.0; 2]);
        }
    }
}

impl SecondOrder {
    fn new(w: f64, damping: f64) -> Self {
        let norm = 1.0 / (1.0 + damping * w + w * w);
        let a = [2.0 * (w * w - 1.0) * norm, (1.0 - damping * w + w * w) * norm];
        Self { gain: norm, a, input: [0.0; 2], output: [0.0; 2] }
    }

    fn update(&mut self, x: f64) -> f64 {
        let ([x1, x2], [y1, y2]) = (self.input, self.output);
        let y = (x - x1 * 2.0 + x2) * self.gain - y1 * self.a[0] - y2 * self.a[1];
        (self.input, self.output) = ([x, x1], [y, y1]);
        y
    }
}
