//! Signed distance of two capsules, and of a capsule and a half-space.

use super::capsule::{Capsule, HalfSpace};
use super::segment::{Segment, closest_fractions};
use nalgebra::{Unit, Vector3};

/// Distance between two axes below which their difference gives no normal, m. It is a hundred thousand roundings of a
/// coordinate of 10 m.
const INTERSECTING_M: f64 = 1e-10;

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
    /// Closest points as fractions of the lengths of the axes; 0 or 1 at an end.
    pub(crate) fractions: [f64; 2],
    /// Distance of the axes, m; `None` if b is a half-space.
    pub(crate) axis_distance: Option<f64>,
}

impl Capsule {
    /// Returns the distance of this capsule (a) from another (b).
    #[inline]
    #[must_use]
    pub fn proximity(&self, other: &Self) -> Proximity {
        let (a, b) = (self.axis(), other.axis());
        let fractions = closest_fractions(&a, &b);
        let (point_a, point_b) = (a.point(fractions[0]), b.point(fractions[1]));
        let from_b = point_a - point_b;
        let apart = from_b.norm();
        let normal =
            if apart > INTERSECTING_M { from_b / apart } else { normal_at_intersection(&a, &b, &from_b) };
        Proximity {
            distance_m: apart - self.radius_m - other.radius_m,
            point_a_m: point_a - normal * self.radius_m,
            point_b_m: point_b + normal * other.radius_m,
            normal,
            fractions,
            axis_distance: Some(apart),
        }
    }

    /// Returns the distance of this capsule (a) from a half-space (b). If the axis is parallel to the plane, the closest
    /// point is that of the first end.
    #[inline]
    #[must_use]
    pub fn half_space_proximity(&self, half_space: &HalfSpace) -> Proximity {
        let normal = half_space.normal;
        let heights = [normal.dot(&self.start_m), normal.dot(&self.end_m)];
        let (fraction, end, height) = if heights[0] <= heights[1] {
            (0.0, self.start_m, heights[0])
        } else {
            (1.0, self.end_m, heights[1])
        };
        let above = height - half_space.offset_m;
        Proximity {
            distance_m: above - self.radius_m,
            point_a_m: end - normal * self.radius_m,
            point_b_m: end - normal * above,
            normal,
            fractions: [fraction, 0.0],
            axis_distance: None,
        }
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
