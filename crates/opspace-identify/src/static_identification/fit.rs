//! Fit of stiffness and friction to the offsets of a joint.
//!
//! ```text
//! K (e − c) = m g + w − Σ h_j P_j ∂g/∂q_j + Σ δ_j ∂g/∂q_j + P F + b q̇
//! ```
//!
//! e is the mean offset of setpoint from position near a posture, g the torque of gravity at the measured posture, w that of a
//! hung weight, P the direction of the motion, F and b Coulomb and viscous friction. Errors of the posture: the links are off the
//! encoders by δ_j (their zeros), and by half of the backlash h_j towards their loads, whose signs are P_j. They and the offset c,
//! at most a count, have normal prior distributions. m is the ratio of true to declared masses; it is one without a hung weight.

use super::parameters::StaticParameters;
use super::sweep::StaticPoint;
use crate::confidence::Interval95;
use crate::least_squares::{Minimum, minimise};
use nalgebra::{DMatrix, DVector};

/// Standard deviation of the zero of an encoder, rad (m): one degree.
const ZERO: f64 = 0.0175;

/// Mean and standard deviation of half of the backlash, rad (m). All joints of an arm may have none, or one degree from end to end.
const HALF_BACKLASH: [f64; 2] = [0.0044, 0.0065];

/// Least standard deviation of a mean offset, in resolutions: rounding of the positions.
const MIN_COUNTS: f64 = 0.05;

/// Number of fits, each with the deviation of the offsets that the one before leaves.
const FITS: usize = 3;

/// Distance over which errors of the model are correlated, as a fraction of the range.
const CORRELATED_OVER: f64 = 0.25;

/// Relative standard deviations that the model does not contain: of stiffness and masses, by elastic gears; of Coulomb friction, by the Stribeck
/// effect; of viscous friction, by times at which the drive reads and acts.
const STIFFNESS_MODEL: f64 = 0.004;
const COULOMB_MODEL: f64 = 0.0075;
const VISCOUS_MODEL: f64 = 0.005;

/// Treatment of the stiffness in a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stiffness {
    /// Estimated with the masses of the URDF.
    Free,
    /// Estimated, as is the ratio of true to declared masses: for points with and without a hung weight.
    FreeWithMasses,
    /// Given, Nm/rad (N/m): for friction.
    Given(f64),
}

/// Result of a fit.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Fit {
    /// Stiffness, Nm/rad (N/m), with its interval.
    pub stiffness: f64,
    /// 95 % interval of the stiffness.
    pub stiffness_interval: Interval95,
    /// Masses over those of the URDF, with the interval; `None` if they are taken from it.
    pub mass_scale: Option<(f64, Interval95)>,
    /// Coulomb friction, Nm (N).
    pub coulomb: f64,
    /// 95 % interval of Coulomb friction.
    pub coulomb_interval: Interval95,
    /// Viscous friction, with the damping of the servo, Nms/rad (Ns/m).
    pub viscous: f64,
    /// 95 % interval of viscous friction.
    pub viscous_interval: Interval95,
    /// Rms error of the offsets, rad (m).
    pub residual: f64,
}

/// Parameters before the errors of the posture: logarithms of stiffness and masses, offset, friction.
const FIRST: usize = 5;

/// Scales of the parameters: 1 corresponds to this offset (rad, m), Coulomb friction (Nm, N), viscous friction (Nms/rad).
struct Scales {
    stiffness: f64,
    offset: f64,
    coulomb: f64,
    viscous: f64,
}

/// Fits the points of a joint; `None` if they do not determine its friction, or a free stiffness.
#[must_use]
pub fn fit(points: &[StaticPoint], known: &StaticParameters, stiffness: Stiffness) -> Option<Fit> {
    let start = start(points, known, stiffness)?;
    let scales = Scales {
        stiffness: start[0],
        offset: known.resolution.max(known.setpoint_resolution).max(1e-6),
        coulomb: start[1].abs().max(1e-6),
        viscous: start[2].abs().max(1e-6),
    };
    let joints = points.first()?.slopes.len();
    // Parameters that are given stay at their start: their prior is narrow.
    let given = [stiffness_is_given(stiffness), stiffness != Stiffness::FreeWithMasses];
    let mut x = vec![0.0; FIRST + 2 * joints];
    (x[3], x[4]) = (start[1] / scales.coulomb, start[2] / scales.viscous);
    let mut deviation = scales.offset;
    let mut best: Option<Minimum> = None;
    for _ in 0..FITS {
        let found = minimise(&x, |x| {
            let mut residuals: Vec<f64> =
                points.iter().map(|point| error(point, x, &scales) / deviation).collect();
            residuals.extend(given.iter().zip(x).map(|(given, x)| if *given { x / NARROW } else { 0.0 }));
            residuals.push(x[2]);
            residuals.extend(&x[FIRST..]);
            Some(residuals)
        })?;
        x.clone_from(&found.x);
        let squares: f64 = found.residuals()[..points.len()].iter().map(|r| (r * deviation).powi(2)).sum();
        let free = points.len().checked_sub(FIRST).filter(|free| *free > 0)?;
        deviation = (squares / free as f64).sqrt().max(MIN_COUNTS * scales.offset);
        best = Some(found);
    }
    result(points, &best?, &scales, stiffness)
}

/// Deviation of a parameter that is given.
const NARROW: f64 = 1e-4;

fn stiffness_is_given(stiffness: Stiffness) -> bool {
    matches!(stiffness, Stiffness::Given(_))
}

/// Difference of the offset of a point from that of the parameters, rad (m).
fn error(point: &StaticPoint, x: &[f64], scales: &Scales) -> f64 {
    let stiffness = scales.stiffness * x[0].exp();
    let joints = point.slopes.len();
    let (zeros, plays) = x[FIRST..].split_at(joints);
    let posture: f64 = (0..joints)
        .map(|j| {
            let half_backlash = HALF_BACKLASH[0] + HALF_BACKLASH[1] * plays[j];
            (ZERO * zeros[j] - half_backlash * point.load_signs[j]) * point.slopes[j]
        })
        .sum();
    let friction = point.speed.signum() * x[3] * scales.coulomb + point.speed * x[4] * scales.viscous;
    let torque = x[1].exp() * point.gravity + point.weight + posture + friction;
    torque / stiffness + x[2] * scales.offset - point.offset
}

/// Stiffness, Coulomb and viscous friction that linear least squares give, without errors of the posture.
fn start(points: &[StaticPoint], known: &StaticParameters, stiffness: Stiffness) -> Option<[f64; 3]> {
    let given = match stiffness {
        Stiffness::Given(stiffness) => Some(stiffness),
        _ => None,
    };
    let columns = if given.is_some() { 2 } else { 3 };
    if points.len() < 2 * columns {
        return None;
    }
    let matrix = DMatrix::from_fn(points.len(), columns, |row, column| {
        let point = &points[row];
        [point.speed.signum(), point.speed, point.gravity + point.weight][column]
    });
    let right = DVector::from_iterator(
        points.len(),
        points.iter().map(|p| p.offset - given.map_or(0.0, |k| (p.gravity + p.weight) / k)),
    );
    let iterations = crate::transfer_function::MAX_ITERATIONS;
    let solved = matrix.try_svd(true, true, f64::EPSILON, iterations)?.solve(&right, 1e-12).ok()?;
    let found = match given {
        Some(stiffness) => stiffness,
        None => 1.0 / solved[2],
    };
    // A slope of the wrong sign is that of noise.
    let found = if found.is_finite() && found > 0.0 { found } else { known.stiffness };
    Some([found, solved[0] * found, solved[1] * found])
}

fn result(points: &[StaticPoint], found: &Minimum, scales: &Scales, stiffness: Stiffness) -> Option<Fit> {
    let (least, most) = points
        .iter()
        .map(|p| p.position)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), q| (least.min(q), most.max(q)));
    let places: Vec<f64> = points.iter().map(|point| point.position).collect();
    let deviations = found.deviations(&places, CORRELATED_OVER * (most - least))?;
    let x = &found.x;
    let value = scales.stiffness * x[0].exp();
    let of_stiffness = if stiffness_is_given(stiffness) { 0.0 } else { deviations[0].hypot(STIFFNESS_MODEL) };
    let squares: f64 = points.iter().map(|point| error(point, x, scales).powi(2)).sum();
    let mass_scale = (stiffness == Stiffness::FreeWithMasses).then(|| {
        let scale = x[1].exp();
        (scale, Interval95::of_logarithm(scale, deviations[1].hypot(STIFFNESS_MODEL)))
    });
    let [coulomb, viscous] = [scales.coulomb * x[3], scales.viscous * x[4]];
    let of_coulomb = (scales.coulomb * deviations[3]).hypot(COULOMB_MODEL * coulomb);
    let of_viscous = (scales.viscous * deviations[4]).hypot(VISCOUS_MODEL * viscous);
    let fit = Fit {
        stiffness: value,
        stiffness_interval: Interval95::of_logarithm(value, of_stiffness),
        mass_scale,
        coulomb,
        coulomb_interval: Interval95::of(coulomb, of_coulomb),
        viscous,
        viscous_interval: Interval95::of(viscous, of_viscous),
        residual: (squares / points.len() as f64).sqrt(),
    };
    fit.stiffness.is_finite().then_some(fit)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stiffness (Nm/rad), Coulomb and viscous friction (Nm; Nms/rad) of the servo.
    const STIFFNESS: f64 = 9.0;
    const COULOMB: f64 = 0.06;
    const VISCOUS: f64 = 0.5;

    /// Largest torque of gravity, and that of a hung weight, Nm.
    const GRAVITY: f64 = 0.8;
    const WEIGHT: f64 = 0.5;

    fn known() -> StaticParameters {
        StaticParameters {
            joint: 0,
            limits: vec![[-2.0, 2.0]],
            resolution: 1.5e-3,
            setpoint_resolution: 1.5e-3,
            stiffness: STIFFNESS,
            lead_s: 0.0,
            damping: 0.0,
        }
    }

    /// Points of a horizontal pendulum at two speeds in both directions; its true masses are `masses` times those of the model. The
    /// link is off the encoder by `zero` and by half of the `backlash` towards its load. `weight` is the torque of a level weight.
    fn points(masses: f64, zero: f64, backlash: f64, weight: f64) -> Vec<StaticPoint> {
        let mut points = Vec::new();
        for speed in [0.4, -0.4, 0.2, -0.2_f64] {
            for k in 0..20 {
                let q = -0.4 + 0.1 * f64::from(k);
                let load = |q: f64| (masses * GRAVITY + weight) * q.cos();
                let link = q + zero - 0.5 * backlash * load(q).signum();
                let torque = load(link) + speed.signum() * COULOMB + speed * VISCOUS;
                points.push(StaticPoint {
                    position: q,
                    speed,
                    gravity: GRAVITY * q.cos(),
                    weight: weight * q.cos(),
                    offset: torque / STIFFNESS,
                    slopes: vec![-(GRAVITY + weight) * q.sin()],
                    load_signs: vec![q.cos().signum()],
                });
            }
        }
        points
    }

    /// Compares estimates with the parameters from which exact points were computed.
    #[test]
    fn parameters_are_recovered_in_spite_of_zero_and_backlash() {
        const TOLERANCE: f64 = 0.005;
        for (zero, backlash) in [(0.0, 0.0), (0.02, 0.0), (0.0, 0.017), (-0.02, 0.017)] {
            let found = fit(&points(1.0, zero, backlash, 0.0), &known(), Stiffness::Free).expect("a fit");
            assert!((found.stiffness / STIFFNESS - 1.0).abs() < TOLERANCE, "{zero} {backlash}: {found:?}");
            assert!((found.coulomb / COULOMB - 1.0).abs() < TOLERANCE, "{zero} {backlash}: {found:?}");
            assert!((found.viscous / VISCOUS - 1.0).abs() < TOLERANCE, "{zero} {backlash}: {found:?}");
        }
    }

    #[test]
    fn masses_and_stiffness_are_separated_by_a_weight() {
        const TOLERANCE: f64 = 0.01;
        const MASSES: f64 = 1.25;
        let alone = points(MASSES, 0.0, 0.01, 0.0);
        let from_gravity = fit(&alone, &known(), Stiffness::Free).expect("a fit");
        assert!((from_gravity.stiffness * MASSES / STIFFNESS - 1.0).abs() < TOLERANCE, "{from_gravity:?}");
        let all = [alone, points(MASSES, 0.0, 0.01, WEIGHT)].concat();
        let found = fit(&all, &known(), Stiffness::FreeWithMasses).expect("a fit");
        let (masses, interval) = found.mass_scale.expect("masses");
        assert!((found.stiffness / STIFFNESS - 1.0).abs() < TOLERANCE, "{found:?}");
        assert!((masses / MASSES - 1.0).abs() < TOLERANCE, "{found:?}");
        assert!((interval.lower..interval.upper).contains(&MASSES), "{found:?}");
    }

    #[test]
    fn given_stiffness_is_kept_and_friction_is_estimated() {
        const TOLERANCE: f64 = 0.01;
        let level: Vec<StaticPoint> = points(1.0, 0.0, 0.0, 0.0)
            .into_iter()
            .map(|point| StaticPoint {
                offset: point.offset - point.gravity / STIFFNESS,
                gravity: 0.0,
                slopes: vec![0.0],
                ..point
            })
            .collect();
        let found = fit(&level, &known(), Stiffness::Given(STIFFNESS)).expect("a fit");
        // The prior of a given stiffness is narrow, not a constraint.
        const GIVEN: f64 = 0.01 * NARROW;
        assert!((found.stiffness / STIFFNESS - 1.0).abs() < GIVEN, "{found:?}");
        assert!((found.coulomb / COULOMB - 1.0).abs() < TOLERANCE, "{found:?}");
        assert!(fit(&level[..3], &known(), Stiffness::Given(STIFFNESS)).is_none());
    }
}
