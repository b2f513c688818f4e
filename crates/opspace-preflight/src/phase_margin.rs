//! Smallest phase margin of a sampled loop.

use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// Phase margin below which a loop is reported, degrees: it oscillates, and an error of a few per cent in inertia or
/// delay makes it unstable.
pub(super) const LEAST_MARGIN_DEG: f64 = 30.0;

/// Phase margin of proposed gains, degrees.
pub(super) const GOOD_MARGIN_DEG: f64 = 45.0;

/// Phase margin of a loop (degrees, at least −180), and its crossover frequency.
#[derive(Clone, Copy, Debug)]
pub(super) struct Margin {
    pub(super) degrees: f64,
    pub(super) crossover_rad_per_s: f64,
}

/// Returns the smallest margin over all crossovers of the open loop, given as a function of the angular frequency (rad/s),
/// from the frequency `first` (rad/s) to half the sampling rate; `None` if the gain is below 1 everywhere. The loop must not have
/// unstable poles.
pub(super) fn least_margin(
    first: f64,
    period_s: f64,
    open_loop: impl Fn(f64) -> Complex<f64>,
) -> Option<Margin> {
    let last = PI / period_s;
    crossovers(first, period_s, open_loop)
        .map(|Crossover { phase, omega }| {
            // The gain is still above 1 at half the sampling rate.
            let phase = if omega < last { phase } else { phase.min(-PI) };
            Margin { degrees: (180.0 + phase.to_degrees()).max(-180.0), crossover_rad_per_s: omega }
        })
        .min_by(|a, b| a.degrees.total_cmp(&b.degrees))
}

/// Returns the smallest angle between the open loop and −1 over all crossovers, as [`least_margin`]; for a loop that is stable
/// although its open loop may have unstable poles.
pub(super) fn least_distance(
    first: f64,
    period_s: f64,
    open_loop: impl Fn(f64) -> Complex<f64>,
) -> Option<Margin> {
    crossovers(first, period_s, open_loop)
        .map(|Crossover { phase, omega }| {
            let degrees = (phase.to_degrees().rem_euclid(360.0) - 180.0).abs();
            Margin { degrees, crossover_rad_per_s: omega }
        })
        .min_by(|a, b| a.degrees.total_cmp(&b.degrees))
}

/// Returns the smallest angle between the open loop and −1 over all crossovers, as [`least_margin`]; negative if the closed loop is
/// unstable, by Nyquist's criterion. The open loop must have no unstable poles, at most one integrator, and a small gain at half the
/// sampling rate. With resonances, the phase at a crossover does not tell whether the loop is stable.
pub(super) fn nyquist_margin(
    first: f64,
    period_s: f64,
    open_loop: impl Fn(f64) -> Complex<f64>,
) -> Option<Margin> {
    let least = least_distance(first, period_s, &open_loop)?;
    let at = frequencies(first, period_s);
    let mut before = 1.0 + open_loop(at(0.0));
    let mut turned = before.arg();
    for step in 1..=STEPS {
        let now = 1.0 + open_loop(at(f64::from(step)));
        turned += (now / before).arg();
        before = now;
    }
    let degrees = if turned.abs() < PI { least.degrees } else { -least.degrees };
    Some(Margin { degrees, ..least })
}

/// Frequency (rad/s) at which the gain of a loop is 1, and the loop's phase (rad) there.
#[derive(Clone, Copy, Debug)]
struct Crossover {
    phase: f64,
    omega: f64,
}

/// Returns all crossovers, and half the sampling rate if the gain is above 1 there. The phase is continuous, and begins
/// between −2π and 0.
fn crossovers(
    first: f64,
    period_s: f64,
    open_loop: impl Fn(f64) -> Complex<f64>,
) -> impl Iterator<Item = Crossover> {
    let at = frequencies(first, period_s);
    let mut before = open_loop(at(0.0));
    let mut phase = if before.arg() > 0.0 { before.arg() - TAU } else { before.arg() };
    (1..=STEPS).filter_map(move |step| {
        let now = open_loop(at(f64::from(step)));
        let (from, to) = (before.norm().ln(), now.norm().ln());
        let (phase_before, turned) = (phase, (now / before).arg());
        (before, phase) = (now, phase + turned);
        if (from > 0.0) != (to > 0.0) {
            let share = from / (from - to);
            return Some(Crossover {
                phase: phase_before + share * turned,
                omega: at(f64::from(step) - 1.0 + share),
            });
        }
        (step == STEPS && to > 0.0).then(|| Crossover { phase, omega: at(f64::from(STEPS)) })
    })
}

/// Number of steps of the examined frequencies.
const STEPS: i32 = 600;

/// Frequency (rad/s) at a step: from `first`, or less, in geometric progression to half the sampling rate.
fn frequencies(first: f64, period_s: f64) -> impl Fn(f64) -> f64 + Copy {
    let last = PI / period_s;
    let first = first.min(0.1 * last);
    move |step| first * (last / first).powf(step / f64::from(STEPS))
}

/// Transfer function of a zero-order hold over `period_s`.
pub(super) fn hold(s: Complex<f64>, period_s: f64) -> Complex<f64> {
    (1.0 - (-s * period_s).exp()) / (s * period_s)
}

/// Transfer function of a sampled finite difference over `period_s` with a low-pass filter.
pub(super) fn filtered_difference(s: Complex<f64>, period_s: f64, cutoff_hz: f64) -> Complex<f64> {
    let pole = (-TAU * cutoff_hz * period_s).exp();
    let back = (-s * period_s).exp();
    (1.0 - pole) * (1.0 - back) / (period_s * (1.0 - pole * back))
}

/// Velocity and position at the time `delay_s` (s) later per commanded acceleration until then, with the shift `back` over a period:
/// M₁ = Σ_j (t_j − t_{j−1}) back^j (s) and M₂ = Σ_j ½ (t_j² − t_{j−1}²) back^j (s²), t_j = min(j `period_s`, `delay_s`).
pub(super) fn of_commands_until(delay_s: f64, period_s: f64, back: Complex<f64>) -> [Complex<f64>; 2] {
    let (mut of_velocity, mut of_position) = (Complex::ZERO, Complex::ZERO);
    let (mut began, mut shift) = (0.0, back);
    while began < delay_s {
        let end = delay_s.min(began + period_s);
        of_velocity += shift * (end - began);
        of_position += shift * 0.5 * (end * end - began * began);
        (began, shift) = (began + period_s, shift * back);
    }
    [of_velocity, of_position]
}

/// Formats a number with two digits, rounded down.
pub(super) fn rounded_down(value: f64) -> String {
    let unit = 10f64.powi(value.log10().floor() as i32 - 1);
    super::diagnostic::short((value / unit).floor() * unit)
}
