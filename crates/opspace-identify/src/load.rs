//! Load of a drive, identified from its measured torque and motion: inertia, elastic gear, equivalent friction.
//!
//! From the torque τ̄ and the position y that one setpoint causes, the [interval](crate::interval) gives the force F on the
//! drive in addition to that on an inertia I₀, for any gains of the servo. Friction dissipates like a viscous friction b and
//! stores like a stiffness k, both of which depend on the amplitude; gravity is a stiffness too:
//!
//! ```text
//! F = (J(ω) − I₀) ω² y − jω b y − k y
//! J = I    (rigid gear)        J = B + L κ/(κ − L ω²), κ = K + jω D    (elastic gear, encoder on the rotor)
//! ```
//!
//! B and L are the inertias of rotor and link, K and D stiffness and damping of the gear.

use crate::confidence::Interval95;
use crate::gains::AmplitudeLevel;
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
    omega: f64,
    position: Complex<f64>,
    force: Complex<f64>,
}

/// Identifies the load of a drive; `None` if the responses do not determine an inertia.
#[must_use]
pub fn fit(levels: &[AmplitudeLevel], drive: &Drive, rates: Rates) -> Option<Load> {
    let lines = lines(levels, drive, rates)?;
    let rigid = rigid(&lines, levels.len(), drive)?;
    let elastic = elastic(&lines, &rigid, levels.len(), drive);
    let friction = |x: &[f64], at: usize| (0..levels.len()).map(|l| x[at + 2 * l].max(0.0)).collect();
    let places: Vec<f64> = lines.iter().flat_map(|line| [line.omega.ln(); 2]).collect();
    let residual = |minimum: &Minimum| MODEL_ERROR * minimum.rms();
    match elastic.filter(|e| CLEARLY * e.cost < rigid.cost) {
        None => Some(Load {
            inertia: rigid.x[0].exp(),
            deviation: rigid.deviations(&places, CORRELATED_OVER)?[0],
            fast_inertia: rigid.x[0].exp(),
            friction: friction(&rigid.x, 1),
            gear: None,
            residual: residual(&rigid),
        }),
        Some(found) => {
            let deviations = found.deviations(&places, CORRELATED_OVER)?;
            let inertia = found.x[0].exp();
            let (rotor_share, antiresonance) = (share(found.x[1]), found.x[2].exp());
            let stiffness = antiresonance * antiresonance * inertia * (1.0 - rotor_share);
            // Upper bound, as the three logarithms may be correlated.
            let relative = deviations[0] + deviations[1] * rotor_share + 2.0 * deviations[2];
            Some(Load {
                inertia,
                deviation: deviations[0],
                fast_inertia: inertia * rotor_share,
                friction: friction(&found.x, 4),
                gear: Some(Gear {
                    antiresonance_hz: antiresonance / TAU,
                    resonance_hz: antiresonance / TAU / rotor_share.sqrt(),
                    stiffness,
                    damping_ratio: found.x[3].exp(),
                    rotor_share,
                    stiffness_interval: Interval95::of_logarithm(stiffness, relative),
                }),
                residual: residual(&found),
            })
        }
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
                lines.push(Line { level, omega: TAU * position.hz, position: position.value, force });
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

/// Minimum over [ln I, then b and k of each level].
fn rigid(lines: &[Line], levels: usize, drive: &Drive) -> Option<Minimum> {
    let mut x = vec![drive.inertia.ln()];
    x.extend([0.0, 0.0].repeat(levels));
    let mut minimum = None;
    for _ in 0..2 {
        let (inertia, b): (f64, Vec<f64>) = (x[0].exp(), (0..levels).map(|l| x[1 + 2 * l]).collect());
        let start = linear_start(lines, levels, inertia, &b, drive)?;
        let found = minimise(&start, |x| {
            let residuals = lines.iter().flat_map(|line| {
                let model = force(line, Complex::new(x[0].exp(), 0.0), &x[1..], drive.inertia);
                let error = (model - line.force) / size(line, inertia, b[line.level]);
                [error.re, error.im]
            });
            Some(residuals.collect())
        })?;
        x.clone_from(&found.x);
        minimum = Some(found);
    }
    minimum
}

/// Solves the rigid load by linear least squares: [ln I, then b and k of each level].
fn linear_start(
    lines: &[Line],
    levels: usize,
    inertia: f64,
    b: &[f64],
    drive: &Drive,
) -> Option<Vec<f64>> {
    let mut matrix = DMatrix::zeros(2 * lines.len(), 1 + 2 * levels);
    let mut right = DVector::zeros(2 * lines.len());
    for (k, line) in lines.iter().enumerate() {
        let size = size(line, inertia, b[line.level]);
        let y = line.position / size;
        let columns = [
            (0, y * (line.omega * line.omega)),
            (1 + 2 * line.level, -y * Complex::new(0.0, line.omega)),
            (2 + 2 * line.level, -y),
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
    let start = [if total > 0.0 { total.ln() } else { drive.inertia.ln() }];
    let start: Vec<f64> = start.into_iter().chain(solved.iter().skip(1).copied()).collect();
    start.iter().all(|v| v.is_finite()).then_some(start)
}

/// Minimum over [ln I, logit of the rotor's share, ln of the antiresonance (rad/s), ln of its damping ratio, then b and k of
/// each level], from several starts.
fn elastic(lines: &[Line], rigid: &Minimum, levels: usize, drive: &Drive) -> Option<Minimum> {
    let (inertia, b): (f64, Vec<f64>) = (rigid.x[0].exp(), (0..levels).map(|l| rigid.x[1 + 2 * l]).collect());
    let lowest = lines.iter().map(|line| line.omega).fold(f64::INFINITY, f64::min);
    let highest = lines.iter().map(|line| line.omega).fold(0.0, f64::max);
    let residuals = |x: &[f64]| {
        let residuals = lines.iter().flat_map(|line| {
            let model = force(line, elastic_inertia(x, line.omega), &x[4..], drive.inertia);
            let error = (model - line.force) / size(line, inertia, b[line.level]);
            [error.re, error.im]
        });
        // Weak bounds of what the lines do not determine.
        let bounds = [x[1] / 3.0, (x[2] - highest.ln()) / 2.0, (x[3] - 0.05f64.ln()) / 2.0];
        Some(residuals.chain(bounds).collect())
    };
    let start = |k: usize| {
        let antiresonance = 4.0 * lowest * (1.5 * highest / (4.0 * lowest)).powf(k as f64 / (STARTS - 1) as f64);
        let start = [rigid.x[0], 0.0, antiresonance.ln(), 0.05f64.ln()];
        minimise(&[&start[..], &rigid.x[1..]].concat(), residuals)
    };
    (0..STARTS).filter_map(start).min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Inertia J of an elastic load at the frequency `omega` (rad/s).
fn elastic_inertia(x: &[f64], omega: f64) -> Complex<f64> {
    inertia_share(share(x[1]), x[2].exp(), x[3].exp(), omega) * x[0].exp()
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

/// Force on the drive of an inertia `inertia`, with b and k of each level.
fn force(line: &Line, load: Complex<f64>, frictions: &[f64], inertia: f64) -> Complex<f64> {
    let Line { level, omega, position, .. } = *line;
    let [b, k] = [frictions[2 * level], frictions[2 * level + 1]];
    position * ((load - inertia) * (omega * omega) - Complex::new(k, omega * b))
}
