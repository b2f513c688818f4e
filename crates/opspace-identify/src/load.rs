//! Load of a drive, identified from its measured torque and motion: inertia, elastic gear, equivalent friction.
//!
//! From the torque τ̄ and the position y that one setpoint causes, the [interval](crate::interval) gives the force F on the
//! drive in addition to that on an inertia I₀, for any gains of the servo. Friction is like a viscous friction b that acts
//! through the presliding displacement δ of the bristles, which relax in the time δ/σ at a velocity of rms σ; b depends on
//! the amplitude. Gravity is a stiffness k:
//!
//! ```text
//! F = (J(ω) − I₀) ω² y − jω b/(1 + jω δ/σ) y − k y
//! J = I    (rigid gear)        J = B + L κ/(κ − L ω²), κ = K + jω D    (elastic gear, encoder on the rotor)
//! ```
//!
//! B and L are the inertias of rotor and link, K and D stiffness and damping of the gear.

use crate::amplitude_level::AmplitudeLevel;
use crate::confidence::Interval95;
use crate::interval::{Drive, Interval, Rates};
use crate::least_squares::{Minimum, minimise};
use nalgebra::{Complex, DMatrix, DVector};
use serde::Serialize;
use std::f64::consts::TAU;

/// Band of the fit over the interface rate: below the frequencies that encoder noise dominates.
const BAND: std::ops::Range<f64> = 0.004..0.25;

/// Smallest coherence of a line that is used.
const COHERENT: f64 = 0.9;

/// Width of the correlation of errors over frequency, in its logarithm.
pub(crate) const CORRELATED_OVER: f64 = 0.8;

/// Ratio of the costs without and with an elastic gear above which the gear is elastic.
const CLEARLY: f64 = 2.0;

/// Numbers of antiresonances from which the fit of an elastic gear starts.
const STARTS: usize = 5;

/// Factor of the deviation of the inertia behind an elastic gear over that from residuals, from simulated joints.
const HIDDEN: f64 = 2.5;

/// Range of the inertia over that of the drive, beyond which a fit has failed.
const INERTIAS: std::ops::Range<f64> = 0.02..50.0;

/// Damping ratio of a gear from which fits start.
const LIGHT_DAMPING: f64 = 0.05;

/// Relative error of the model assumed in addition to that of friction.
const MODEL_ERROR: f64 = 0.003;

/// Share of the friction force that is not its linear equivalent.
const NONLINEAR: f64 = 0.3;

/// Elastic gear between rotor and link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Gear {
    /// Frequency at which the link vibrates while the rotor is at rest, Hz.
    pub antiresonance_hz: f64,
    /// Frequency at which the rotor vibrates against the link, Hz.
    pub resonance_hz: f64,
    /// Stiffness, Nm/rad (N/m), or divided by the inertia (1/s²).
    pub stiffness: f64,
    /// Damping ratio of the vibration while the rotor is at rest.
    pub damping_ratio: f64,
    /// Inertia of the rotor over that of rotor and link.
    pub rotor_share: f64,
    /// 95 % interval of the stiffness.
    pub stiffness_interval: Interval95,
}

impl Gear {
    /// Inertia J over that of rotor and link, at the frequency `omega` (rad/s).
    #[must_use]
    pub fn inertia_share(&self, omega: f64) -> Complex<f64> {
        inertia_share(self.rotor_share, TAU * self.antiresonance_hz, self.damping_ratio, omega)
    }
}

/// Identified load.
#[derive(Clone, Debug)]
pub struct Load {
    /// Inertia of rotor and link, kg m² (kg).
    pub inertia: f64,
    /// Standard deviation of its logarithm.
    pub deviation: f64,
    /// Inertia that the drive moves at high frequencies: that of the rotor if the gear is elastic.
    pub fast_inertia: f64,
    /// Equivalent viscous friction at each level, Nms/rad (Ns/m).
    pub friction: Vec<f64>,
    /// Gear, if it is clearly elastic.
    pub gear: Option<Gear>,
    /// Relative rms error of the force.
    pub residual: f64,
}

/// Force at one line.
struct Line {
    level: usize,
    speed: f64,
    omega: f64,
    position: Complex<f64>,
    force: Complex<f64>,
}

/// Identifies the load of a drive; `None` if the responses do not determine an inertia.
#[must_use]
pub fn fit(levels: &[AmplitudeLevel], drive: &Drive, rates: Rates) -> Option<Load> {
    let lines = lines(levels, drive, rates)?;
    let (plain, rigid) = rigid(&lines, levels.len(), drive)?;
    let elastic = elastic(&lines, &rigid, levels.len(), drive);
    let clearly = elastic.filter(|e| CLEARLY * e.cost < rigid.cost);
    let selected = clearly.as_ref().unwrap_or(&rigid);
    let places: Vec<f64> = lines.iter().flat_map(|line| [line.omega.ln(); 2]).collect();
    let deviations = selected.deviations(&places, CORRELATED_OVER)?;
    let inertia = selected.x[0].exp();
    if !INERTIAS.contains(&(inertia / drive.inertia)) {
        return None;
    }
    let friction = selected.x[FRICTIONS..FRICTIONS + levels.len()].iter().map(|b| b.max(0.0)).collect();
    let gear = clearly.as_ref().map(|found| gear(found, &deviations, FRICTIONS + levels.len()));
    Some(Load {
        inertia,
        deviation: match gear {
            // The model of friction is not exact: what the relaxation of the bristles changes may be wrong by half.
            None => deviations[0].hypot(0.5 * (rigid.x[0] - plain)),
            // With a gear, which can follow errors of that model, residuals show only a part of them.
            Some(_) => HIDDEN * deviations[0],
        },
        fast_inertia: inertia * gear.map_or(1.0, |gear| gear.rotor_share),
        friction,
        gear,
        residual: MODEL_ERROR * selected.rms(),
    })
}

/// Gear of a fit whose parameters of the gear begin at the index `at`.
fn gear(found: &Minimum, deviations: &[f64], at: usize) -> Gear {
    let (rotor_share, antiresonance) = (share(found.x[at]), found.x[at + 1].exp());
    let stiffness = antiresonance * antiresonance * found.x[0].exp() * (1.0 - rotor_share);
    // Upper bound, as the three logarithms may be correlated.
    let relative = deviations[0] + deviations[at] * rotor_share + 2.0 * deviations[at + 1];
    Gear {
        antiresonance_hz: antiresonance / TAU,
        resonance_hz: antiresonance / TAU / rotor_share.sqrt(),
        stiffness,
        damping_ratio: found.x[at + 2].exp(),
        rotor_share,
        stiffness_interval: Interval95::of_logarithm(stiffness, relative),
    }
}

fn lines(levels: &[AmplitudeLevel], drive: &Drive, rates: Rates) -> Option<Vec<Line>> {
    let interval = Interval::new(drive, rates);
    let mut lines = Vec::new();
    for (level, responses) in levels.iter().enumerate() {
        let torque = responses.torque.as_ref()?;
        for (position, torque) in responses.position.iter().zip(torque) {
            if BAND.contains(&(position.hz * rates.period_s())) && position.coherence > COHERENT {
                let force = interval.responses(position.hz)?.force_of_torque(position.value, torque.value);
                lines.push(Line {
                    level,
                    speed: responses.speed,
                    omega: TAU * position.hz,
                    position: position.value,
                    force,
                });
            }
        }
    }
    Some(lines)
}

/// Error of the force of a line that is expected of the model, with friction `b` (Nms/rad).
fn size(line: &Line, inertia: f64, b: f64) -> f64 {
    let Line { omega, position, .. } = line;
    let inertial = inertia * omega * omega * position.norm();
    f64::hypot(MODEL_ERROR * inertial, NONLINEAR * MODEL_ERROR.sqrt() * b * omega * position.norm())
}

/// Index of the first b among the parameters: after ln I, ln δ and k.
const FRICTIONS: usize = 3;

/// Presliding displacement δ if the responses do not determine it, rad (m), and its tolerance factor.
const PRESLIDING: f64 = 1e-3;
const PRESLIDING_WITHIN: f64 = 10.0;

/// Residual of the prior of δ.
fn presliding_prior(x: &[f64]) -> f64 {
    (x[1] - PRESLIDING.ln()) / PRESLIDING_WITHIN.ln()
}

/// ln I without relaxation of the bristles, and minimum over [ln I, ln δ, k, then b of each level].
fn rigid(lines: &[Line], levels: usize, drive: &Drive) -> Option<(f64, Minimum)> {
    let mut start = linear_start(lines, levels, drive.inertia, &vec![0.0; levels], drive)?;
    let mut minimum = None;
    for _ in 0..2 {
        let (inertia, b) = (start[0].exp(), start[FRICTIONS..].to_vec());
        let found = minimise(&start, |x| {
            let mut residuals = Vec::with_capacity(2 * lines.len() + 1);
            for line in lines {
                let model = force(line, Complex::new(x[0].exp(), 0.0), x, drive.inertia);
                let error = (model - line.force) / size(line, inertia, b[line.level]);
                residuals.extend([error.re, error.im]);
            }
            residuals.push(presliding_prior(x));
            Some(residuals)
        })?;
        start.clone_from(&found.x);
        minimum = Some(found);
    }
    let b = start[FRICTIONS..].to_vec();
    let plain = linear_start(lines, levels, start[0].exp(), &b, drive)?;
    Some((plain[0], minimum?))
}

/// Solves the rigid load without relaxation of the bristles by linear least squares: [ln I, ln δ, k, then b of each level].
fn linear_start(lines: &[Line], levels: usize, inertia: f64, b: &[f64], drive: &Drive) -> Option<Vec<f64>> {
    let mut matrix = DMatrix::zeros(2 * lines.len(), 2 + levels);
    let mut right = DVector::zeros(2 * lines.len());
    for (k, line) in lines.iter().enumerate() {
        let size = size(line, inertia, b[line.level]);
        let y = line.position / size;
        let columns = [
            (0, y * (line.omega * line.omega)),
            (1, -y),
            (2 + line.level, -y * Complex::new(0.0, line.omega)),
        ];
        for (column, value) in columns {
            matrix[(2 * k, column)] = value.re;
            matrix[(2 * k + 1, column)] = value.im;
        }
        right[2 * k] = line.force.re / size;
        right[2 * k + 1] = line.force.im / size;
    }
    let iterations = crate::transfer_function::MAX_ITERATIONS;
    let solved = matrix.try_svd(true, true, f64::EPSILON, iterations)?.solve(&right, 1e-14).ok()?;
    let total = drive.inertia + solved[0];
    let total = if total > 0.0 { total } else { drive.inertia };
    let start: Vec<f64> =
        [total.ln(), PRESLIDING.ln()].into_iter().chain(solved.iter().skip(1).copied()).collect();
    start.iter().all(|v| v.is_finite()).then_some(start)
}

/// Minimum over the parameters of a rigid load, then [logit of the rotor's share, ln of the antiresonance (rad/s), ln of its
/// damping ratio], from several starts.
fn elastic(lines: &[Line], rigid: &Minimum, levels: usize, drive: &Drive) -> Option<Minimum> {
    let at = FRICTIONS + levels;
    let (inertia, b) = (rigid.x[0].exp(), &rigid.x[FRICTIONS..]);
    let lowest = lines.iter().map(|line| line.omega).fold(f64::INFINITY, f64::min);
    let highest = lines.iter().map(|line| line.omega).fold(0.0, f64::max);
    let residuals = |x: &[f64]| {
        let mut residuals = Vec::with_capacity(2 * lines.len() + 4);
        for line in lines {
            let model = force(line, elastic_inertia(x[0], &x[at..], line.omega), x, drive.inertia);
            let error = (model - line.force) / size(line, inertia, b[line.level]);
            residuals.extend([error.re, error.im]);
        }
        residuals.push(presliding_prior(x));
        // Weak bounds of what the lines do not determine.
        let gear = &x[at..];
        residuals.extend([
            gear[0] / 3.0,
            (gear[1] - highest.ln()) / 2.0,
            (gear[2] - LIGHT_DAMPING.ln()) / 2.0,
        ]);
        Some(residuals)
    };
    let start = |k: usize| {
        let antiresonance =
            4.0 * lowest * (1.5 * highest / (4.0 * lowest)).powf(k as f64 / (STARTS - 1) as f64);
        let gear = [0.0, antiresonance.ln(), LIGHT_DAMPING.ln()];
        minimise(&[&rigid.x[..], &gear[..]].concat(), residuals)
    };
    (0..STARTS).filter_map(start).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Inertia J of an elastic load at the frequency `omega` (rad/s).
fn elastic_inertia(logarithm: f64, gear: &[f64], omega: f64) -> Complex<f64> {
    inertia_share(share(gear[0]), gear[1].exp(), gear[2].exp(), omega) * logarithm.exp()
}

/// Inertia J over that of rotor and link at the frequency `omega`, with the antiresonance `natural` (rad/s).
fn inertia_share(rotor_share: f64, natural: f64, damping_ratio: f64, omega: f64) -> Complex<f64> {
    let gear = Complex::new(natural * natural, 2.0 * damping_ratio * natural * omega);
    gear / (gear - omega * omega) * (1.0 - rotor_share) + rotor_share
}

/// Share between 0 and 1 of its logit.
fn share(logit: f64) -> f64 {
    1.0 / (1.0 + (-logit).exp())
}

/// Force on a drive of an inertia `inertia` with these parameters of friction.
fn force(line: &Line, load: Complex<f64>, x: &[f64], inertia: f64) -> Complex<f64> {
    let Line { level, speed, omega, position, .. } = *line;
    let rate = Complex::new(0.0, omega);
    let friction = rate * x[FRICTIONS + level] / (rate * (x[1].exp() / speed) + 1.0);
    position * ((load - inertia) * (omega * omega) - friction - x[2])
}
