//! Signed distance of two capsules, and of a capsule and a half-space.

use super::capsule::{Capsule, HalfSpace};
use super::segment::{Segment, closest_fractions};
use nalgebra::{Unit, Vector3};

/// Distance between two axes below which their difference gives no normal, m. It is a hundred thousand roundings of a
/// coordinate of 10 m.
pub(crate) const INTERSECTING_M: f64 = 1e-10;

/// Signed distance of two objects a and b, with their closest points, in world axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proximity {
    /// Distance of the surfaces, m. It is negative if the objects penetrate each other, and then the depth.
    pub distance_m: f64,
    /// Point of the surface of a that is closest to b (if they penetrate, deepest in b), m.
    pub point_a_m: Vector3<f64>,
    /// Point of the surface of b that is closest to a (if they penetrate, deepest in a), m.
    pub point_b_m: Vector3<f64>,
    /// Unit vector from b to a: the direction in which the motion of a increases the distance the most.
    ///
    /// If the axes of two capsules intersect, it is perpendicular to both; its sign is then arbitrary.
    pub normal: Vector3<f64>,
    /// Closest points of the axes of a and b, m; for a half-space, the point of its plane.
    pub(crate) axis_points: [Vector3<f64>; 2],
    /// Closest points as fractions of the lengths of the axes; 0 or 1 at an end.
    pub(crate) fractions: [f64; 2],
    /// Axes; `None` if b is a half-space.
    pub(crate) axes: Option<Axes>,
}

/// Axes of two capsules in world axes, from end to end (m), and their distance (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axes {
    pub along_a: Vector3<f64>,
    pub along_b: Vector3<f64>,
    pub apart_m: f64,
}

impl Capsule {
    /// Returns the distance of this capsule (a) from another (b).
    #[must_use]
    pub fn proximity(&self, other: &Self) -> Proximity {
        let (a, b) = (self.axis(), other.axis());
        between_capsules((&a, self.radius_m), (&b, other.radius_m), closest_fractions(&a, &b))
    }

    /// Returns the distance of this capsule (a) from a half-space (b). If the axis is parallel to the plane, the
    /// closest point is that of the first end.
    #[must_use]
    pub fn half_space_proximity(&self, half_space: &HalfSpace) -> Proximity {
        from_half_space((&self.axis(), self.radius_m), half_space)
    }
}

/// Returns the distance of two capsules, each given by its axis and its radius (m), whose axes are closest at these
/// fractions of their lengths.
#[inline]
pub(crate) fn between_capsules(
    (a, radius_a): (&Segment, f64),
    (b, radius_b): (&Segment, f64),
    fractions: [f64; 2],
) -> Proximity {
    let (point_a, point_b) = (a.point(fractions[0]), b.point(fractions[1]));
    let from_b = point_a - point_b;
    let apart_m = from_b.norm();
    let normal =
        if apart_m > INTERSECTING_M { from_b / apart_m } else { normal_at_intersection(a, b, &from_b) };
    Proximity {
        distance_m: apart_m - radius_a - radius_b,
        point_a_m: point_a - normal * radius_a,
        point_b_m: point_b + normal * radius_b,
        normal,
        axis_points: [point_a, point_b],
        fractions,
        axes: Some(Axes { along_a: a.along, along_b: b.along, apart_m }),
    }
}

/// Returns the distance of a capsule, given by its axis and its radius (m), from a half-space.
#[inline]
pub(crate) fn from_half_space((a, radius): (&Segment, f64), half_space: &HalfSpace) -> Proximity {
    let normal = half_space.normal;
    let fraction = if normal.dot(&a.along) < 0.0 { 1.0 } else { 0.0 };
    let end = a.point(fraction);
    let above = normal.dot(&end) - half_space.offset_m;
    Proximity {
        distance_m: above - radius,
        point_a_m: end - normal * radius,
        point_b_m: end - normal * above,
        normal,
        axis_points: [end, end - normal * above],
        fractions: [fraction, 0.0],
        axes: None,
    }
}

/// Returns a unit vector that is perpendicular to both axes, on the side of `from_b`; if they are parallel, one that is
/// perpendicular to the longer axis; z if both are points.
#[cold]
fn normal_at_intersection(a: &Segment, b: &Segment, from_b: &Vector3<f64>) -> Vector3<f64> {
    let (axis_a, axis_b) = (Unit::try_new(a.along, 0.0), Unit::try_new(b.along, 0.0));
    if let (Some(axis_a), Some(axis_b)) = (axis_a, axis_b)
        && let Some(normal) = Unit::try_new(axis_a.cross(&axis_b), INTERSECTING_M)
    {
        return if normal.dot(from_b) < 0.0 { -normal.into_inner() } else { normal.into_inner() };
    }
    let longer = if a.along.norm_squared() >= b.along.norm_squared() { axis_a } else { axis_b };
    // The coordinate axis with the smallest component along the axis gives the best-conditioned cross product.
    let across = longer.and_then(|axis| Unit::try_new(Vector3::ith(axis.iamin(), 1.0).cross(&axis), 0.0));
    across.map_or_else(Vector3::z, Unit::into_inner)
}
