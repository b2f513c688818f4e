//! Distances of capsules, compared with parry and with the conditions of a minimum.
#![expect(clippy::unwrap_used, reason = "a test")]

use nalgebra::Vector3;
use opspace_model::collision::{Capsule, HalfSpace};
use parry3d_f64::math::{Pose, Vector};
use parry3d_f64::query;
use parry3d_f64::shape::Segment;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Tolerance of a distance, m.
const TOLERANCE_M: f64 = 1e-9;

fn vector(rng: &mut ChaCha8Rng, range: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-range..range))
}

/// Kinds of pairs, in turn: general, parallel, nearly parallel, with one or two spheres, touching at an inner point,
/// touching at an end, on one line, coincident, of very different lengths.
fn pair(rng: &mut ChaCha8Rng, kind: usize) -> [Capsule; 2] {
    let (start, along) = (vector(rng, 1.0), vector(rng, 1.0));
    let radii = [rng.random_range(0.0..0.2), rng.random_range(0.0..0.2)];
    let (other, other_along) = (vector(rng, 1.0), vector(rng, 1.0));
    let fraction: f64 = rng.random_range(0.0..1.0);
    let inner = start + along * fraction;
    let (b, b_along) = match kind % 12 {
        1 => (other, along * rng.random_range(-2.0..2.0)),
        2 => {
            let angle = 10.0_f64.powf(rng.random_range(-13.0..-3.0));
            (other, along * rng.random_range(-2.0..2.0) + other_along * angle)
        }
        3 => (other, Vector3::zeros()),
        4 => return [Capsule::sphere(start, radii[0]), Capsule::sphere(other, radii[1])],
        5 => (inner - other_along * rng.random_range(0.0..1.0), other_along),
        6 => (inner, other_along),
        7 => (start + along, other_along),
        8 => (start + along * rng.random_range(-3.0..3.0), along * rng.random_range(-2.0..2.0)),
        9 => (start, along),
        10 => (other, other_along * 1e-7),
        11 => (start + Vector3::new(1e-13, 0.0, 0.0), along + other_along * 1e-9),
        _ => (other, other_along),
    };
    [
        Capsule { start_m: start, end_m: start + along, radius_m: radii[0] },
        Capsule { start_m: b, end_m: b + b_along, radius_m: radii[1] },
    ]
}

fn pairs() -> impl Iterator<Item = (usize, [Capsule; 2])> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    (0..14_000).map(move |i| (i % 12, pair(&mut rng, i)))
}

/// Distance of the axes by parry, in which a segment without length is a point.
fn parry_distance(a: &Capsule, b: &Capsule) -> f64 {
    let [a, b] = [a, b].map(|c| {
        let point = |p: &Vector3<f64>| Vector::new(p.x, p.y, p.z);
        Segment::new(point(&c.start_m), point(&c.end_m))
    });
    query::details::distance_segment_segment(&Pose::IDENTITY, &a, &b)
}

/// Compared: distances, and those of parry's segments. Parry's are longer for nearly parallel segments, and for
/// segments as short as 1e-7 m, which it takes for points: see the next test.
#[test]
fn distances_agree_with_parry() {
    let mut compared = 0;
    for (kind, [a, b]) in pairs() {
        let theirs = parry_distance(&a, &b) - a.radius_m - b.radius_m;
        let error = a.proximity(&b).distance_m - theirs;
        assert!(error < TOLERANCE_M, "kind {kind}: {error:e}, {a:?} {b:?}");
        if ![2, 10, 11].contains(&kind) {
            assert!(error > -TOLERANCE_M, "kind {kind}: {error:e}, {a:?} {b:?}");
            compared += 1;
        }
        assert!(error > -1e-3, "kind {kind}: {error:e}, {a:?} {b:?}");
    }
    assert!(compared > 10_000, "{compared}");
}

/// Compared: distances, and the minimum over one axis of the distance from the other, by bisection of an interval: that
/// distance is a convex function.
#[test]
fn distances_agree_with_a_search() {
    for (kind, [a, b]) in pairs() {
        let along = a.end_m - a.start_m;
        let from_b = |s: f64| b.distance_m(&(a.start_m + along * s)) - a.radius_m;
        let (mut lower, mut upper) = (0.0, 1.0);
        for _ in 0..120 {
            let third = (upper - lower) / 3.0;
            if from_b(lower + third) <= from_b(upper - third) { upper -= third } else { lower += third }
        }
        let error = a.proximity(&b).distance_m - from_b(0.5 * (lower + upper));
        assert!(error.abs() < TOLERANCE_M, "kind {kind}: {error:e}, {a:?} {b:?}");
    }
}

/// Compared: closest points and normal, and their definitions: points on the surfaces at the stated distance along a
/// unit normal, and no point of an axis that is closer to the closest point of the other axis. As the squared distance
/// is convex in the two points, these conditions prove the minimum.
#[test]
fn closest_points_are_those_of_a_minimum() {
    for (kind, [a, b]) in pairs() {
        let p = a.proximity(&b);
        assert!((p.normal.norm() - 1.0).abs() < 1e-12, "kind {kind}");
        assert!((p.point_a_m - p.point_b_m - p.normal * p.distance_m).norm() < TOLERANCE_M, "kind {kind}");
        let (on_a, on_b) = (p.point_a_m + p.normal * a.radius_m, p.point_b_m - p.normal * b.radius_m);
        assert!((a.distance_m(&on_a) + a.radius_m).abs() < TOLERANCE_M, "kind {kind}");
        assert!((b.distance_m(&on_b) + b.radius_m).abs() < TOLERANCE_M, "kind {kind}");
        let apart = p.distance_m + a.radius_m + b.radius_m;
        assert!(a.distance_m(&on_b) + a.radius_m > apart - TOLERANCE_M, "kind {kind}: {a:?} {b:?}");
        assert!(b.distance_m(&on_a) + b.radius_m > apart - TOLERANCE_M, "kind {kind}: {a:?} {b:?}");
    }
}

/// Compared: the distances of a pair in both orders, and after a motion of both.
#[test]
fn distance_is_symmetric() {
    for (kind, [a, b]) in pairs() {
        let (forward, backward) = (a.proximity(&b), b.proximity(&a));
        assert!((forward.distance_m - backward.distance_m).abs() < TOLERANCE_M, "kind {kind}");
        if ![1, 2, 5, 6, 7, 8, 9, 11].contains(&kind) {
            assert!((forward.normal + backward.normal).norm() < 1e-6, "kind {kind}: {a:?} {b:?}");
        }
    }
}

/// Compared: the normal of two crossing axes, and the direction that is perpendicular to both.
#[test]
fn normal_of_intersecting_axes_is_perpendicular_to_both() {
    let x = Capsule { start_m: -Vector3::x(), end_m: Vector3::x(), radius_m: 0.1 };
    let y = Capsule { start_m: -Vector3::y(), end_m: Vector3::y(), radius_m: 0.2 };
    let p = x.proximity(&y);
    assert_eq!((p.distance_m, p.normal.z.abs()), (-0.1 - 0.2, 1.0));
    let p = x.proximity(&x);
    assert_eq!((p.distance_m, p.normal.x), (-0.2, 0.0));
    let point = Capsule::sphere(Vector3::zeros(), 0.3);
    assert_eq!(point.proximity(&point).normal, Vector3::z());
    assert!(x.proximity(&point).normal.x.abs() < 1e-15);
}

/// Compared: the distance of a half-space, and the smallest height of points on the axis, less the radius.
#[test]
fn half_space_distance_is_that_of_the_lowest_point() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for (_, [a, _]) in pairs().take(2_000) {
        let wall =
            HalfSpace { normal: vector(&mut rng, 1.0).normalize(), offset_m: rng.random_range(-1.0..1.0) };
        let p = a.half_space_proximity(&wall);
        let height = |s: f64| wall.normal.dot(&(a.start_m + (a.end_m - a.start_m) * s)) - wall.offset_m;
        let lowest = (0..=100).map(|i| height(f64::from(i) / 100.0)).min_by(f64::total_cmp).unwrap();
        assert!((p.distance_m - (lowest - a.radius_m)).abs() < 1e-12);
        assert!((wall.normal.dot(&p.point_b_m) - wall.offset_m).abs() < 1e-12);
        assert!((p.point_a_m - p.point_b_m - p.normal * p.distance_m).norm() < 1e-12);
    }
}
