//! Distances of all pairs of a collision model in one state.

use super::capsule::{CollisionShape, HalfSpace};
use super::model::CollisionModel;
use super::proximity::{Proximity, between_capsules, from_half_space};
use super::segment::{Segment, closest_fractions};
use crate::data::Data;
use crate::model::Model;
use nalgebra::Vector3;

/// Results for all pairs of a collision model, allocated once. By [`collision_distances`].
#[derive(Clone, Debug)]
pub struct CollisionData {
    /// Proximity of each pair, in the order of [`CollisionModel::pairs`]; `None` if the objects are farther apart than
    /// requested.
    pub proximity: Vec<Option<Proximity>>,
    /// Capsules in world axes, in the order of the objects; their lengths are zero for half-spaces.
    placed: Vec<Placed>,
}

/// Capsule in world axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub(super) axis: Segment,
    middle: Vector3<f64>,
    pub(super) radius_m: f64,
    reach_m: f64,
}

impl CollisionData {
    /// Allocates the results for `collision`. All pairs are far apart until their distances are computed.
    #[must_use]
    pub fn new(collision: &CollisionModel) -> Self {
        let zero = Vector3::zeros();
        let point = Placed { axis: Segment::new(zero, zero), middle: zero, radius_m: 0.0, reach_m: 0.0 };
        Self {
            proximity: vec![None; collision.pairs().len()],
            placed: vec![point; collision.objects().len()],
        }
    }

    /// Returns the pairs that are within the requested distance, each with its index in [`CollisionModel::pairs`].
    pub fn near(&self) -> impl Iterator<Item = (usize, &Proximity)> {
        self.proximity.iter().enumerate().filter_map(|(pair, proximity)| Some((pair, proximity.as_ref()?)))
    }

    /// Returns the capsule of an object in world axes.
    pub(super) fn placed(&self, object: usize) -> &Placed {
        &self.placed[object]
    }
}

/// Computes the distances of all pairs that are at most `within_m` apart. Pairs whose enclosing spheres are farther
/// apart are skipped; `f64::INFINITY` computes all. Needs [`forward_kinematics`](crate::forward_kinematics). Does not
/// allocate.
///
/// If a joint position is not finite, the distances that depend on it are NaN.
///
/// # Panics
/// If `out` was allocated for a collision model with fewer objects or another number of pairs.
pub fn collision_distances(
    collision: &CollisionModel,
    model: &Model,
    data: &Data,
    within_m: f64,
    out: &mut CollisionData,
) {
    assert_eq!(out.proximity.len(), collision.pairs.len(), "one row for each pair");
    place_capsules(collision, model, data, out);
    let placed = &out.placed[..collision.objects.len()];
    for (row, pair) in out.proximity.iter_mut().zip(&collision.pairs) {
        let a = &placed[pair.a];
        let proximity = match &collision.objects[pair.b].shape {
            CollisionShape::Capsule(_) => near_capsules(a, &placed[pair.b], within_m),
            CollisionShape::HalfSpace(half_space) => near_half_space(a, half_space, within_m),
        };
        // A distance that is not a number is not skipped.
        *row = proximity.filter(|proximity| !is_beyond(proximity.distance_m, within_m));
    }
}

/// Places all capsules in world axes, for distances of single pairs. [`collision_distances`] does the same. Needs
/// [`forward_kinematics`](crate::forward_kinematics). Does not allocate.
pub fn place_capsules(collision: &CollisionModel, model: &Model, data: &Data, out: &mut CollisionData) {
    for (placed, object) in out.placed.iter_mut().zip(&collision.objects) {
        let CollisionShape::Capsule(capsule) = &object.shape else { continue };
        let axis = capsule.placed(&object.holder.placement(model, data)).axis();
        *placed =
            Placed { axis, middle: axis.point(0.5), radius_m: capsule.radius_m, reach_m: object.reach_m };
    }
}

/// Returns the proximity of one pair in the state for which [`place_capsules`] or [`collision_distances`] placed the
/// capsules in `placed`, however far apart its objects are. Does not allocate.
///
/// # Panics
/// If there is no such pair.
#[inline]
#[must_use]
pub fn pair_proximity(collision: &CollisionModel, placed: &CollisionData, pair: usize) -> Proximity {
    let pair = collision.pairs[pair];
    let a = placed.placed(pair.a);
    match &collision.objects[pair.b].shape {
        CollisionShape::Capsule(_) => {
            let b = placed.placed(pair.b);
            let fractions = closest_fractions(&a.axis, &b.axis);
            between_capsules((&a.axis, a.radius_m), (&b.axis, b.radius_m), fractions)
        }
        CollisionShape::HalfSpace(half_space) => from_half_space((&a.axis, a.radius_m), half_space),
    }
}

/// Returns true if a distance is certainly larger than `within`: false for NaN.
#[inline]
fn is_beyond(distance: f64, within: f64) -> bool {
    distance > within
}

#[inline]
fn near_capsules(a: &Placed, b: &Placed, within_m: f64) -> Option<Proximity> {
    // Squares are compared: no square root is needed for pairs that are far apart.
    if is_beyond_square((a.middle - b.middle).norm_squared(), a.reach_m + b.reach_m + within_m) {
        return None;
    }
    let fractions = closest_fractions(&a.axis, &b.axis);
    let apart = a.axis.point(fractions[0]) - b.axis.point(fractions[1]);
    // With a margin for rounding: the caller compares the distance itself.
    if is_beyond_square(apart.norm_squared() * 0.999_999, a.radius_m + b.radius_m + within_m) {
        return None;
    }
    Some(between_capsules((&a.axis, a.radius_m), (&b.axis, b.radius_m), fractions))
}

/// Returns true if a distance, given by its square, is certainly larger than `within`.
#[inline]
fn is_beyond_square(square: f64, within: f64) -> bool {
    within < 0.0 || is_beyond(square, within * within)
}

#[inline]
fn near_half_space(a: &Placed, half_space: &HalfSpace, within_m: f64) -> Option<Proximity> {
    let above = half_space.normal.dot(&a.middle) - half_space.offset_m - a.reach_m;
    (!is_beyond(above, within_m)).then(|| from_half_space((&a.axis, a.radius_m), half_space))
}
