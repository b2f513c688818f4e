//! Identification of the servo from frequency responses: the exact multirate model is fitted to the measurements.
//!
//! With measured motor current, input and output of the drive are known: setpoint and position, and torque. Its gains
//! are then determined for any motion of the joint (see [`interval`](crate::interval)). Without measured current the
//! only known quantity is T = y/q_desired,
//!
//! ```text
//! T ≈ kv kp / (I s² + (kv + b) s + kv kp)
//! ```
//!
//! so that only kv kp/I and (kv + b)/I are determined. Coulomb friction is known from the joint's lag at constant
//! speed. It is modelled as the viscous friction √(2/π) Fc/σ, which dissipates the same power for a Gaussian velocity
//! of standard deviation σ. The lag at constant speed also gives (kv + b)/(kv kp), much more accurately. Viscous friction b must be known: if it is taken as zero, the identified kv is too high by b, and
//! the identified kp is too low accordingly, by some percent.

use crate::interval::{Drive, Interval, Rates};
use crate::least_squares::{Minimum, minimise};
use crate::response::Point;
use crate::transfer_function::MAX_ITERATIONS;
use crate::transfer_function::relative;
use nalgebra::{Complex, DMatrix, DVector};
use opspace_backend::Setpoints;
use std::f64::consts::TAU;

/// Relative error of the model assumed in the weights, in addition to noise.
const MODEL_ERROR: f64 = 0.01;

/// Relative error of the position error per speed assumed in the weights: that of slow motion is known much better than
/// the responses.
const SLOW_ERROR: f64 = 1e-4;

/// Prior values of a drive's filter and current loop, used if the data don't determine them, each with its tolerance
/// factor: a filter at an eighth of the servo rate, a current loop of 1 kHz.
const FILTER_OF_RATE: f64 = 0.125;
const FILTER_WITHIN: f64 = 10.0;
pub(super) const CURRENT_LOOP_HZ: f64 = 1000.0;
const CURRENT_LOOP_WITHIN: f64 = 4.0;

/// Number of alternating fits of gains and of inertia.
const TURNS: usize = 4;

/// Frequency responses at one amplitude.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct AmplitudeLevel {
    /// Rms of the joint's velocity, rad/s (m/s).
    pub speed: f64,
    /// Response of position to setpoint.
    pub position: Vec<Point>,
    /// Response of mean torque to setpoint, Nm/rad (N/m), if current is measured.
    pub torque: Option<Vec<Point>>,
}

/// Lag of a joint behind its setpoint at constant speed.
#[derive(Clone, Copy, Debug, Default)]
#[non_exhaustive]
pub struct Lag {
    /// Part due to Coulomb friction, rad (m).
    pub at_rest: f64,
    /// Part per unit of speed, s, due to the servo, viscous friction and sampling; 0 if unknown.
    pub per_speed: f64,
}

impl Lag {
    /// Mean position error of the servo per unit of speed, s: the lag between position and setpoint of a sample is longer.
    fn error_per_speed(self, rates: Rates) -> Option<f64> {
        let half = 0.5 * f64::from(rates.servo_ticks_per_cycle - 1);
        let late = match rates.setpoints {
            Setpoints::Held => half,
            Setpoints::Interpolated => 2.0 * half,
        };
        let error = self.per_speed - rates.servo_period_s * (f64::from(rates.delay) + late);
        (self.per_speed > 0.0 && error > 0.0).then_some(error)
    }
}

/// Fitted servo.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Gains {
    /// Drive and joint. If torque was not measured, the inertia is 1 and kv is divided by the inertia.
    pub drive: Drive,
    /// Delay until a setpoint acts, in servo ticks.
    pub delay: u32,
    /// Relative standard deviations of kp and kv.
    pub deviation: [f64; 2],
    /// Viscous friction equivalent to the joint's friction, for each level, Nms/rad (Ns/m), or 1/s if torque was not
    /// measured.
    pub friction: Vec<f64>,
    /// Relative rms error of the modelled torque, if torque was measured.
    pub torque_residual: Option<f64>,
    /// Ratio of the cost with the second-best delay to the cost with the best one.
    pub delay_margin: f64,
}

/// Fits the servo and its delay, which replaces that of `rates`. The `lag` of the joint behind its setpoint, and its `viscous`
/// friction divided by its inertia (1/s), are used if torque is not measured. Returns `None` if the responses don't
/// determine the servo.
#[must_use]
pub fn fit(levels: &[AmplitudeLevel], rates: Rates, lag: Lag, viscous: f64) -> Option<Gains> {
    let measured = levels.iter().all(|l| l.torque.is_some());
    let mut fitted: Vec<(f64, Gains)> = Vec::new();
    for delay in 0..=rates.servo_ticks_per_cycle {
        let rates = Rates { delay, ..rates };
        let one =
            if measured { with_torque(levels, rates) } else { without_torque(levels, rates, lag, viscous) };
        fitted.extend(one);
    }
    fitted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let second = fitted.get(1).map_or(f64::INFINITY, |(cost, _)| *cost);
    let (cost, gains) = fitted.into_iter().next()?;
    Some(Gains { delay_margin: second / cost, ..gains })
}

fn with_torque(levels: &[AmplitudeLevel], rates: Rates) -> Option<(f64, Gains)> {
    let mut drive = rough(levels, &rates)?;
    let mut found = None;
    let mut friction = Vec::new();
    for _ in 0..TURNS {
        let drive_of = |x: &[f64]| Drive {
            kp: x[0].exp(),
            kv: x[1].exp(),
            velocity_filter_hz: x[2].exp(),
            current_loop_hz: x[3].exp(),
            inertia: drive.inertia,
        };
        let start = [drive.kp.ln(), drive.kv.ln(), drive.velocity_filter_hz.ln(), drive.current_loop_hz.ln()];
        let minimum = minimise(&start, |x| {
            let interval = Interval::new(&drive_of(x), rates);
            let mut residuals = Vec::new();
            for (position, torque) in pairs(levels) {
                let r = interval.responses(position.hz)?;
                let through = (r.torque_of_force / r.position_of_force).norm() * position.noise;
                let size = f64::hypot(torque.noise + through, MODEL_ERROR * torque.value.norm());
                let error = (r.torque(position.value) - torque.value) / size;
                residuals.extend([error.re, error.im]);
            }
            residuals.push(beyond(x[2], FILTER_OF_RATE / rates.servo_period_s, FILTER_WITHIN));
            residuals.push(beyond(x[3], CURRENT_LOOP_HZ, CURRENT_LOOP_WITHIN));
            Some(residuals)
        })?;
        drive = drive_of(&minimum.x);
        let (more, viscous) = joint(levels, &drive, rates)?;
        drive.inertia = (drive.inertia + more).max(0.1 * drive.inertia);
        friction = viscous;
        found = Some(minimum);
    }
    let minimum = found?;
    let interval = Interval::new(&drive, rates);
    let torque = pairs(levels)
        .filter_map(|(p, t)| Some((interval.responses(p.hz)?.torque(p.value), t.value)))
        .collect::<Vec<_>>();
    let residual = relative(torque.into_iter());
    Some(gains(drive, rates, &minimum, friction, Some(residual)))
}

fn without_torque(levels: &[AmplitudeLevel], rates: Rates, lag: Lag, viscous: f64) -> Option<(f64, Gains)> {
    let corner = corner_hz(&levels.first()?.position)?;
    let drive_of = |x: &[f64]| Drive {
        kp: x[0].exp(),
        kv: x[1].exp(),
        velocity_filter_hz: x[2].exp(),
        current_loop_hz: CURRENT_LOOP_HZ,
        inertia: 1.0,
    };
    let friction_of = |x: &[f64], level: &AmplitudeLevel| {
        viscous + (2.0 / std::f64::consts::PI).sqrt() * lag.at_rest * (x[0] + x[1]).exp() / level.speed
    };
    let error_per_speed = lag.error_per_speed(rates);
    let filter_hz = FILTER_OF_RATE / rates.servo_period_s;
    let residuals = |x: &[f64]| {
        let interval = Interval::new(&drive_of(x), rates);
        let mut residuals = Vec::new();
        for level in levels {
            let b = friction_of(x, level);
            for point in &level.position {
                let model = interval.responses(point.hz)?.position_with_friction(b, TAU * point.hz);
                let size = f64::hypot(point.noise, MODEL_ERROR * point.value.norm());
                let error = (model - point.value) / size;
                residuals.extend([error.re, error.im]);
            }
        }
        residuals.push(beyond(x[2], filter_hz, FILTER_WITHIN));
        if let Some(measured) = error_per_speed {
            let Drive { kp, kv, .. } = drive_of(x);
            residuals.push(((kv + viscous) / (kp * kv * measured) - 1.0) / SLOW_ERROR);
        }
        Some(residuals)
    };
    let starts = [2.0, 5.0].into_iter().filter_map(|stiffer| {
        let kp = TAU * corner;
        minimise(&[kp.ln(), (stiffer * kp).ln(), filter_hz.ln()], residuals)
    });
    let minimum = starts.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let friction = levels.iter().map(|level| friction_of(&minimum.x, level)).collect();
    Some(gains(drive_of(&minimum.x), rates, &minimum, friction, None))
}

/// Frequency at which the phase reaches −45°, near the corner of the position loop, Hz.
#[must_use]
pub fn corner_hz(position: &[Point]) -> Option<f64> {
    Some(position.iter().find(|p| p.value.arg() < -TAU / 8.0).or(position.last())?.hz)
}

fn gains(
    drive: Drive,
    rates: Rates,
    minimum: &Minimum,
    friction: Vec<f64>,
    torque_residual: Option<f64>,
) -> (f64, Gains) {
    let deviation = [minimum.deviation[0], minimum.deviation[1]];
    let (delay, delay_margin) = (rates.delay, f64::INFINITY);
    let gains = Gains { drive, delay, deviation, friction, torque_residual, delay_margin };
    (minimum.cost, gains)
}

/// Residual of a prior on a logarithm: its distance from the logarithm of the `likely` value, divided by the logarithm
/// of the tolerance factor `within`.
fn beyond(logarithm: f64, likely: f64, within: f64) -> f64 {
    (logarithm - likely.ln()) / within.ln()
}

/// Returns pairs of position and torque responses at all excited frequencies of all amplitude levels; empty without
/// measured torque.
fn pairs(levels: &[AmplitudeLevel]) -> impl Iterator<Item = (&Point, &Point)> {
    levels.iter().flat_map(|level| level.position.iter().zip(level.torque.iter().flatten()))
}

/// Returns initial gains from a continuous-time model, with h the delay of the setpoint plus half an interval:
/// `τ = K (h q_desired − y) − kv jω y`, `τ = −I ω² y + b jω y`.
fn rough(levels: &[AmplitudeLevel], rates: &Rates) -> Option<Drive> {
    let low = |hz: f64| hz * rates.period_s() < 0.15;
    let late = (f64::from(rates.delay) + 0.5 * f64::from(rates.servo_ticks_per_cycle)) * rates.servo_period_s;
    let mut rows = Vec::new();
    let mut moves = Vec::new();
    for (position, torque) in pairs(levels).filter(|(p, _)| low(p.hz)) {
        let (t, s) = (position.value, torque.value);
        let jw = Complex::new(0.0, TAU * position.hz);
        rows.push(([Complex::from_polar(1.0, -TAU * position.hz * late) - t, -jw * t], s));
        moves.push(([jw * jw * t, jw * t], s));
    }
    let [stiffness, kv] = linear(&rows)?;
    let [inertia, _] = linear(&moves)?;
    let usable = stiffness > 0.0 && kv > 0.0 && inertia > 0.0;
    usable.then(|| Drive {
        kp: stiffness / kv,
        kv,
        velocity_filter_hz: FILTER_OF_RATE / rates.servo_period_s,
        current_loop_hz: CURRENT_LOOP_HZ,
        inertia,
    })
}

/// Returns the joint's inertia in addition to that of `drive`, and the viscous friction at each level, from the force
/// that the model needs to explain the positions. Inertia is fitted above the frequencies dominated by friction and
/// below those dominated by encoder noise; friction is fitted at low frequencies.
fn joint(levels: &[AmplitudeLevel], drive: &Drive, rates: Rates) -> Option<(f64, Vec<f64>)> {
    let interval = Interval::new(drive, rates);
    let within = |from: f64, to: f64| {
        move |p: &&Point| (from..to).contains(&(p.hz * rates.period_s())) && p.coherence > 0.95
    };
    let mut rows = Vec::new();
    for point in levels.iter().flat_map(|l| &l.position).filter(within(0.03, 0.25)) {
        let omega = TAU * point.hz;
        let force = interval.responses(point.hz)?.force(point.value);
        let size = drive.inertia * omega * omega * point.value.norm();
        let y = point.value / size;
        rows.push(([y * (omega * omega), -y * Complex::new(0.0, omega)], force / size));
    }
    let [more, _] = linear(&rows)?;
    let mut friction = Vec::new();
    for level in levels {
        let (mut power, mut work) = (0.0, 0.0);
        for point in level.position.iter().filter(within(0.0, 0.1)) {
            let omega = TAU * point.hz;
            let force =
                interval.responses(point.hz)?.force(point.value) - point.value * (more * omega * omega);
            let velocity = point.value * Complex::new(0.0, omega);
            power += velocity.norm_sqr();
            work -= (force * velocity.conj()).re;
        }
        friction.push((work / power).max(0.0));
    }
    Some((more, friction))
}

/// Solves for two real coefficients of complex columns, by least squares.
fn linear(rows: &[([Complex<f64>; 2], Complex<f64>)]) -> Option<[f64; 2]> {
    let mut matrix = DMatrix::zeros(2 * rows.len(), 2);
    let mut right = DVector::zeros(2 * rows.len());
    for (k, (columns, value)) in rows.iter().enumerate() {
        for (c, column) in columns.iter().enumerate() {
            matrix[(2 * k, c)] = column.re;
            matrix[(2 * k + 1, c)] = column.im;
        }
        right[2 * k] = value.re;
        right[2 * k + 1] = value.im;
    }
    let solved = matrix.try_svd(true, true, f64::EPSILON, MAX_ITERATIONS)?.solve(&right, 1e-14).ok()?;
    solved.iter().all(|v| v.is_finite()).then(|| [solved[0], solved[1]])
}
