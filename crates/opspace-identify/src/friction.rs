//! Identification of friction from runs at constant speed in both directions.
//!
//! Half the difference of the torques in the two directions, at the same positions, is friction, because gravity is the
//! same in both. As a function of speed it is Stribeck's curve plus viscous friction,
//! `Fc + (Fs − Fc) exp(−(v/vs)²) + Fv v`. The intervals of Fc and Fv are those of their profile likelihood: all values for
//! which some curve, with any Stribeck velocity or none, fits about as well as the best one.

use crate::confidence::{Interval95, student_95};
use crate::transfer_function::MAX_ITERATIONS;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// Number of Stribeck velocities tried, as fractions of the highest speed.
const GRID: i32 = 24;

/// Stribeck velocity if the data show no Stribeck effect, rad/s (m/s).
const NO_STRIBECK: f64 = 0.05;

/// Friction of a joint, with the parameters of robot.toml.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Friction {
    /// Coulomb friction Fc, Nm (N).
    pub coulomb: f64,
    /// Static friction Fs, Nm (N).
    pub static_friction: f64,
    /// Stribeck velocity vs, rad/s (m/s).
    pub stribeck: f64,
    /// Viscous friction Fv, Nms/rad (Ns/m).
    pub viscous: f64,
    /// Rms residual of the fit, Nm (N).
    pub residual: f64,
}

impl Friction {
    /// Friction of the curve at `speed` (rad/s, m/s; above 0), Nm (N).
    #[must_use]
    pub fn at(&self, speed: f64) -> f64 {
        let fall = (-(speed / self.stribeck).powi(2)).exp();
        self.coulomb + (self.static_friction - self.coulomb) * fall + self.viscous * speed
    }
}

/// Friction measured at one speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ConstantVelocityRun {
    /// Speed, rad/s (m/s), above 0.
    pub speed: f64,
    /// Friction: half the difference of both directions' torques, Nm (N).
    pub torque: f64,
}

/// Fits the curve to runs at different speeds; `None` with fewer than three.
#[must_use]
pub fn fit(passes: &[ConstantVelocityRun]) -> Option<Friction> {
    best_curve(passes, &[true, true, false], &[[true, true, true], [true, false, true]])
}

/// Fits the curve to runs at different speeds with a given `viscous` friction (Nms/rad, Ns/m): without measured torque, motion
/// does not distinguish it from the gain kv. `None` with fewer than three runs.
#[must_use]
pub fn fit_with_viscous(passes: &[ConstantVelocityRun], viscous: f64) -> Option<Friction> {
    let others: Vec<ConstantVelocityRun> =
        (passes.iter()).map(|p| ConstantVelocityRun { torque: p.torque - viscous * p.speed, ..*p }).collect();
    let found = best_curve(&others, &[true, false, false], &[[true, false, true]])?;
    Some(Friction { viscous, ..found })
}

/// Fits curves with these columns [Coulomb, viscous, Stribeck], `plain` without and `peaked` with the Stribeck effect.
fn best_curve(passes: &[ConstantVelocityRun], plain: &[bool; 3], peaked: &[[bool; 3]]) -> Option<Friction> {
    let highest = passes.iter().map(|p| p.speed).fold(0.0, f64::max);
    let slowest = passes.iter().map(|p| p.speed).fold(f64::INFINITY, f64::min);
    if passes.len() < 3 || highest <= 0.0 {
        return None;
    }
    let mut best = curve(passes, NO_STRIBECK, plain)?;
    // Of a peak below the slowest run, the runs show only the tail: its height, the static friction, could be anything.
    for stribeck in stribeck_velocities(passes).filter(|stribeck| *stribeck >= slowest) {
        for columns in peaked {
            if let Some(found) = curve(passes, stribeck, columns)
                && found.residual < 0.999 * best.residual
            {
                best = found;
            }
        }
    }
    Some(best)
}

/// Smallest standard deviation of a run relative to the largest friction, for errors that all runs have in common.
const COMMON_ERROR: f64 = 0.003;

/// Returns the 95 % intervals of Coulomb friction (Nm, N) and viscous friction (Nms/rad, Ns/m); `None` with too few runs.
#[must_use]
pub fn intervals(passes: &[ConstantVelocityRun]) -> Option<[Interval95; 2]> {
    let with_peak = stribeck_velocities(passes).map(|stribeck| ([true, true, true], stribeck));
    let curves: Vec<LinearFit> = [([true, true, false], NO_STRIBECK)]
        .into_iter()
        .chain(with_peak)
        .filter_map(|(columns, stribeck)| LinearFit::new(passes, stribeck, &columns))
        .filter(|fit| !fit.columns[2] || fit.of(2) >= 0.0)
        .collect();
    let best = curves.iter().min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    // A curve with a Stribeck velocity has one parameter more than columns.
    let parameters = best.columns.iter().filter(|used| **used).count() + usize::from(best.columns[2]);
    let degrees = passes.len().checked_sub(parameters).filter(|degrees| *degrees > 0)?;
    let largest = passes.iter().map(|p| p.torque.abs()).fold(0.0, f64::max);
    let variance = (best.cost / degrees as f64).max((COMMON_ERROR * largest).powi(2));
    let bound = best.cost + student_95(degrees).powi(2) * variance;
    let interval = |column: usize| {
        let ends = curves.iter().filter(|fit| fit.cost <= bound).map(|fit| {
            let half = ((bound - fit.cost) * fit.variances[column]).sqrt();
            Interval95 { lower: fit.of(column) - half, upper: fit.of(column) + half }
        });
        let all = ends.reduce(|a, b| a.union(&b))?;
        Some(Interval95 { lower: all.lower.max(0.0), upper: all.upper.max(0.0) })
    };
    Some([interval(0)?, interval(1)?])
}

/// Stribeck velocities that are tried, rad/s (m/s): a grid from a hundredth to a half of the highest speed.
fn stribeck_velocities(passes: &[ConstantVelocityRun]) -> impl Iterator<Item = f64> {
    let highest = passes.iter().map(|p| p.speed).fold(0.0, f64::max);
    (0..GRID).map(move |step| highest * 0.01 * 50f64.powf(f64::from(step) / f64::from(GRID - 1)))
}

/// Linear least squares of a curve with a given Stribeck velocity, and some of the columns [Coulomb, viscous, Stribeck].
struct LinearFit {
    columns: [bool; 3],
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    coefficients: DVector<f64>,
    /// Diagonal of the inverse normal matrix.
    variances: Vec<f64>,
    /// Sum of squared residuals.
    cost: f64,
}

impl LinearFit {
    fn new(passes: &[ConstantVelocityRun], stribeck: f64, columns: &[bool; 3]) -> Option<Self> {
        let value = |column: usize, speed: f64| match column {
            0 => 1.0,
            1 => speed,
            _ => (-(speed / stribeck).powi(2)).exp(),
        };
        let used: Vec<usize> = (0..3).filter(|&c| columns[c]).collect();
        if passes.len() < used.len() {
            return None;
        }
        let matrix = DMatrix::from_fn(passes.len(), used.len(), |k, c| value(used[c], passes[k].speed));
        let right = DVector::from_iterator(passes.len(), passes.iter().map(|p| p.torque));
        let coefficients =
            matrix.clone().try_svd(true, true, f64::EPSILON, MAX_ITERATIONS)?.solve(&right, 1e-12).ok()?;
        let variances = match matrix.tr_mul(&matrix).try_inverse() {
            Some(inverse) => inverse.diagonal().iter().map(|v| v.max(0.0)).collect(),
            None => vec![f64::INFINITY; used.len()],
        };
        let cost = (&matrix * &coefficients - &right).norm_squared();
        Some(Self { columns: *columns, matrix, right, coefficients, variances, cost })
    }

    /// Coefficient of a column; 0 if it is not used.
    fn of(&self, column: usize) -> f64 {
        let at = self.columns[..column].iter().filter(|used| **used).count();
        if self.columns[column] { self.coefficients[at] } else { 0.0 }
    }
}

/// Curve with a given Stribeck velocity and some of the columns [Coulomb, viscous, Stribeck]; `None` if a coefficient of a
/// Stribeck fit would be negative.
fn curve(passes: &[ConstantVelocityRun], stribeck: f64, columns: &[bool; 3]) -> Option<Friction> {
    let mut fit = LinearFit::new(passes, stribeck, columns)?;
    if columns[2] && fit.coefficients.iter().any(|v| *v < 0.0) {
        return None;
    }
    fit.coefficients.apply(|v| *v = v.max(0.0));
    Some(Friction {
        coulomb: fit.of(0),
        static_friction: fit.of(0) + fit.of(2),
        stribeck,
        viscous: fit.of(1),
        residual: (&fit.matrix * &fit.coefficients - &fit.right).norm() / (passes.len() as f64).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passes(truth: Friction) -> Vec<ConstantVelocityRun> {
        let speeds = (0..8).map(|k| 1.2 * 0.55f64.powi(k));
        speeds.map(|speed| ConstantVelocityRun { speed, torque: truth.at(speed) }).collect()
    }

    /// Compares the fitted curve with the one from which the runs are computed.
    #[test]
    fn stribeck_curve_is_recovered() {
        const TOLERANCE: f64 = 0.03;
        let truth =
            Friction { coulomb: 1.8, static_friction: 2.34, stribeck: 0.06, viscous: 2.0, residual: 0.0 };
        let found = fit(&passes(truth)).expect("eight passes");
        for (f, t) in [
            (found.coulomb, truth.coulomb),
            (found.static_friction, truth.static_friction),
            (found.viscous, truth.viscous),
        ] {
            assert!((f / t - 1.0).abs() < TOLERANCE, "{found:?}");
        }
    }

    #[test]
    fn friction_without_peak_has_no_stribeck_term() {
        const TOLERANCE: f64 = 1e-6;
        let truth =
            Friction { coulomb: 0.4, static_friction: 0.4, stribeck: 0.05, viscous: 0.0, residual: 0.0 };
        let found = fit(&passes(truth)).expect("eight passes");
        assert!((found.static_friction - 0.4).abs() < TOLERANCE && found.viscous < TOLERANCE, "{found:?}");
        assert_eq!(fit(&[]), None);
    }

    /// Static friction is that of some run where the peak is below the speeds of all, however noise changes the slowest one.
    #[test]
    fn static_friction_is_not_extrapolated() {
        let truth =
            Friction { coulomb: 0.07, static_friction: 0.09, stribeck: 0.004, viscous: 0.6, residual: 0.0 };
        for error in [-0.01, 0.002, 0.01, 0.02] {
            let mut runs = passes(truth);
            runs[7].torque += error;
            let found = fit_with_viscous(&runs, 0.6).expect("eight passes");
            assert!(found.static_friction > 0.0 && found.static_friction < 0.2, "{error}: {found:?}");
        }
    }

    /// Compares the fit of runs whose torques contain an error proportional to speed, as an error of kv does, with the
    /// viscous friction that is given.
    #[test]
    fn given_viscous_friction_is_kept() {
        const TOLERANCE: f64 = 0.05;
        let truth =
            Friction { coulomb: 1.8, static_friction: 2.34, stribeck: 0.06, viscous: 2.05, residual: 0.0 };
        let found = fit_with_viscous(&passes(truth), 2.0).expect("eight passes");
        assert_eq!(found.viscous, 2.0);
        assert!((found.coulomb / truth.coulomb - 1.0).abs() < TOLERANCE, "{found:?}");
    }
}
