//! Smallest phase margin of a sampled loop.

use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// Phase margin of a loop (degrees), and its crossover frequency.
#[derive(Clone, Copy, Debug)]
pub(super) struct Margin {
    pub(super) degrees: f64,
    pub(super) crossover_rad_per_s: f64,
}

/// Returns the smallest margin over all crossovers of the open loop, given as a function of the angular frequency (rad/s),
/// from the frequency `first` (rad/s) to half the sampling rate; `None` if the gain is below 1 everywhere.
pub(super) fn least_margin(
    first: f64,
    period_s: f64,
    open_loop: impl Fn(f64) -> Complex<f64>,
) -> Option<Margin> {
    const STEPS: i32 = 600;
    let last = PI / period_s;
    let first = first.min(0.1 * last);
    let at = |step: f64| first * (last / first).powf(step / f64::from(STEPS));
    let mut before = open_loop(first);
    let mut phase = if before.arg() > 0.0 { before.arg() - TAU } else { before.arg() };
    let mut least: Option<Margin> = None;
    let mut note = |phase: f64, omega: f64| {
        let margin = Margin { degrees: 180.0 + phase.to_degrees(), crossover_rad_per_s: omega };
        if least.is_none_or(|least| margin.degrees < least.degrees) {
            least = Some(margin);
        }
    };
    for step in 1..=STEPS {
        let now = open_loop(at(f64::from(step)));
        let next_phase = phase + (now / before).arg();
        if (before.norm() > 1.0) != (now.norm() > 1.0) {
            let (from, to) = (before.norm().ln(), now.norm().ln());
            let share = from / (from - to);
            note(phase + share * (next_phase - phase), at(f64::from(step) - 1.0 + share));
        }
        (before, phase) = (now, next_phase);
    }
    // The gain is still above 1 at half the sampling rate.
    if before.norm() > 1.0 {
        note(phase.min(-PI), last);
    }
    least
}

/// Transfer function of a zero-order hold over `period_s`.
pub(super) fn hold(s: Complex<f64>, period_s: f64) -> Complex<f64> {
    (1.0 - (-s * period_s).exp()) / (s * period_s)
}

/// Formats a number with two digits, rounded down.
pub(super) fn rounded_down(value: f64) -> String {
    let unit = 10f64.powi(value.log10().floor() as i32 - 1);
    super::diagnostic::short((value / unit).floor() * unit)
}
