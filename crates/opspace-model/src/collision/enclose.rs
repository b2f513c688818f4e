//! Capsules that enclose points, prisms and ellipsoids.

use super::capsule::Capsule;
use crate::spatial::Inertia;
use nalgebra::{Matrix3, SymmetricEigen, Unit, Vector3};
use std::f64::consts::PI;

/// Factor of a radius that covers rounding errors.
const ROUNDED_UP: f64 = 1.0 + 1e-12;

/// Number of directions whose farthest points represent a set of points while the axis is searched.
const DIRECTIONS: usize = 256;

/// Number of trials of the search for the axis. Most sets need less than half of them.
const TRIALS: usize = 3000;

/// Largest number of iterations of a decomposition; some ten are enough.
const MAX_ITERATIONS: usize = 1000;

/// Half the length of the axis, and the radius, of the smallest capsule around a cylinder of half the length
/// `half_length` and radius `radius` (m), or around a box whose cross-section has this circumradius.
///
/// A capsule whose axis is shorter by d at each end needs the radius √(`radius`² + d²). The volume has one minimum over
/// d, which is found by interval reduction.
pub(super) fn around_cylinder(half_length: f64, radius: f64) -> (f64, f64) {
    let wider = |shorter: f64| radius.hypot(shorter) * ROUNDED_UP;
    let volume = |shorter: f64| volume(2.0 * (half_length - shorter), wider(shorter));
    let (mut lower, mut upper) = (0.0, half_length);
    for _ in 0..80 {
        let third = (upper - lower) / 3.0;
        if volume(lower + third) <= volume(upper - third) { upper -= third } else { lower += third }
    }
    let shorter = 0.5 * (lower + upper);
    (half_length - shorter, wider(shorter))
}

/// Returns a capsule around the uniform ellipsoid with the mass and the moments of `inertia`; `None` without mass or
/// moments, and if it is larger than any link (a mass close to zero).
///
/// The squared semi-axes are 5 (I₂ + I₃ − I₁) / 2m and so on. With the two longest a ≥ b, the capsule of radius b whose
/// axis reaches to a − b encloses the ellipsoid: it touches its tip and its waist.
pub(super) fn around_inertia(inertia: &Inertia) -> Option<Capsule> {
    let (moments, axes) = eigen(&inertia.rotational)?;
    let sum: f64 = moments.iter().sum();
    let semi_axis = |k: usize| (2.5 * (sum - 2.0 * moments[k]).max(0.0) / inertia.mass).sqrt();
    let (longest, second) = (semi_axis(0), semi_axis(1));
    if !(inertia.mass > 0.0 && longest > 0.0 && longest.is_finite()) {
        return None;
    }
    let along = axes[0] * (longest - second);
    let radius_m = second * ROUNDED_UP;
    let capsule = Capsule { start_m: inertia.com - along, end_m: inertia.com + along, radius_m };
    capsule.is_valid().then_some(capsule)
}

/// Returns a small capsule that encloses all points (m); `None` without points.
///
/// The axis is searched from the three principal axes of the points. The radius is then the largest distance of any
/// point from the axis, so that every point is enclosed whatever the search has found.
pub fn enclosing_capsule(points: &[Vector3<f64>]) -> Option<Capsule> {
    let far = extreme_points(points);
    let mean = far.iter().sum::<Vector3<f64>>() / far.len().max(1) as f64;
    let spread: Matrix3<f64> = far.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let axes = match eigen(&spread) {
        Some((_, axes)) => axes,
        None => [Vector3::x(), Vector3::y(), Vector3::z()],
    };
    let fits = axes.iter().filter_map(|axis| Some(shrunk(along_axis(&far, axis)?, &far)));
    let best = fits.min_by(|a, b| a.volume_m3().total_cmp(&b.volume_m3()))?;
    Some(with_radius(best.start_m, best.end_m, points))
}

/// Returns the capsule with these ends that just encloses the points.
fn with_radius(start_m: Vector3<f64>, end_m: Vector3<f64>, points: &[Vector3<f64>]) -> Capsule {
    let axis = Capsule { start_m, end_m, radius_m: 0.0 };
    let farthest = points.iter().map(|point| axis.distance_m(point)).fold(0.0, f64::max);
    // The error of a distance is some roundings of the coordinates.
    let size = start_m.amax().max(end_m.amax());
    Capsule { radius_m: farthest * ROUNDED_UP + 8.0 * f64::EPSILON * size, ..axis }
}

/// Volume of a capsule with an axis of length `length` (m), m³.
fn volume(length: f64, radius: f64) -> f64 {
    PI * radius * radius * (length + 4.0 / 3.0 * radius)
}

/// Returns the points that are farthest in directions that are distributed evenly; all points if there are few.
fn extreme_points(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    if points.len() <= DIRECTIONS {
        return points.to_vec();
    }
    let golden_angle = PI * (3.0 - 5.0_f64.sqrt());
    let mut chosen: Vec<usize> = (0..DIRECTIONS)
        .filter_map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / DIRECTIONS as f64;
            let (sin, cos) = (golden_angle * i as f64).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let direction = Vector3::new(across * cos, across * sin, z);
            let heights = points.iter().map(|point| direction.dot(point)).enumerate();
            heights.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index)
        })
        .collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen.iter().map(|&i| points[i]).collect()
}

/// Returns the smallest capsule around the points whose axis is the middle line, in direction `axis`, of their bounds.
fn along_axis(points: &[Vector3<f64>], axis: &Vector3<f64>) -> Option<Capsule> {
    let axis = Unit::try_new(*axis, 0.0)?;
    let x = Unit::try_new(Vector3::ith(axis.iamin(), 1.0).cross(&axis), 0.0)?;
    let y = axis.cross(&x);
    let middle = |direction: &Vector3<f64>| {
        let (lower, upper) = points
            .iter()
            .map(|point| direction.dot(point))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, u), h| (l.min(h), u.max(h)));
        0.5 * (lower + upper)
    };
    let center = x.into_inner() * middle(&x) + y * middle(&y);
    let across = |point: &Vector3<f64>| (point - axis.into_inner() * axis.dot(point) - center).norm();
    let radius = points.iter().map(across).fold(0.0, f64::max);
    // Each point must be within the hemisphere at either end, or beside the axis.
    let (mut lower, mut upper) = (f64::INFINITY, f64::NEG_INFINITY);
    for point in points {
        let height = axis.dot(point);
        let reach = (radius * radius - across(point).powi(2)).max(0.0).sqrt();
        (lower, upper) = (lower.min(height + reach), upper.max(height - reach));
    }
    if lower > upper {
        (lower, upper) = (0.5 * (lower + upper), 0.5 * (lower + upper));
    }
    let end = |height: f64| center + axis.into_inner() * height;
    (!points.is_empty()).then(|| with_radius(end(lower), end(upper), points))
}

/// Moves the ends of a capsule at random as long as its volume decreases, with steps that grow after a success and
/// shrink after a failure (evolution strategy with the rule of one fifth). The radius follows from the ends.
fn shrunk(first: Capsule, points: &[Vector3<f64>]) -> Capsule {
    let mut best = first;
    let mut best_volume = best.volume_m3();
    let size = (best.end_m - best.start_m).norm() + best.radius_m;
    let mut step = 0.1 * size;
    let mut random = Random(1);
    for _ in 0..TRIALS {
        if step <= 1e-6 * size {
            break;
        }
        let mut moved = |end: &Vector3<f64>| end + Vector3::from_fn(|_, _| random.next()) * step;
        let (start, end) = (moved(&best.start_m), moved(&best.end_m));
        let trial = with_radius(start, end, points);
        let volume = trial.volume_m3();
        if volume < best_volume {
            (best, best_volume) = (trial, volume);
            step *= 1.5;
        } else {
            step *= 0.93;
        }
    }
    best
}

/// Generator of numbers from −1 to 1 (SplitMix64), so that equal meshes have equal capsules everywhere.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// Returns eigenvalues in ascending order, with their axes; `None` if the matrix is zero or not finite.
fn eigen(symmetric: &Matrix3<f64>) -> Option<([f64; 3], [Vector3<f64>; 3])> {
    // Scaled to order one first, because the square of a tiny or huge number under- or overflows.
    let scale = symmetric.amax();
    if !(scale > 0.0 && scale.is_finite() && symmetric.iter().all(|x| x.is_finite())) {
        return None;
    }
    let decomposed = SymmetricEigen::try_new(symmetric / scale, f64::EPSILON, MAX_ITERATIONS)?;
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| decomposed.eigenvalues[i].total_cmp(&decomposed.eigenvalues[j]));
    let values = order.map(|i| decomposed.eigenvalues[i] * scale);
    Some((values, order.map(|i| decomposed.eigenvectors.column(i).into_owned())))
}
