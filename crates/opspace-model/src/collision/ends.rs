//! Distances of the ends of capsules, beside the smallest distance of a pair.

use super::capsule::CollisionShape;
use super::distances::{CollisionData, Placed};
use super::model::{CollisionModel, CollisionPair};
use super::proximity::{Proximity, between_capsules, from_half_space};
use super::segment::{Segment, closest_fractions};
use nalgebra::Vector3;

/// Sides of a pair, and fractions of the lengths of their axes at which their ends are.
const ENDS: [(Side, f64); 4] = [(Side::A, 0.0), (Side::A, 1.0), (Side::B, 0.0), (Side::B, 1.0)];

#[derive(Clone, Copy, PartialEq)]
enum Side {
    A,
    B,
}

/// Returns the distances of the ends of both capsules of a pair, as spheres, from the other object; without those whose
/// distance is that of the pair, `closest`. Distances and gradients are those of the state for which
/// [`collision_distances`](super::collision_distances) computed `near`. Does not allocate.
///
/// None of them is smaller than the distance of the pair. When the axes become parallel, the closest points jump from
/// one end to the other, and the gradient of the pair's distance with them; those of the ends are continuous.
///
/// # Panics
/// If there is no such pair.
pub fn end_proximities<'a>(
    collision: &'a CollisionModel,
    near: &'a CollisionData,
    pair: usize,
    closest: &'a Proximity,
) -> impl Iterator<Item = Proximity> + 'a {
    let CollisionPair { a, b } = collision.pairs[pair];
    let (first, second) = (near.placed(a), near.placed(b));
    let shape = &collision.objects[b].shape;
    ENDS.into_iter().filter_map(move |(side, fraction)| {
        let (own, place) = match side {
            Side::A => (first, closest.fractions[0]),
            Side::B => (second, closest.fractions[1]),
        };
        // The end of a sphere is its centre.
        if place == fraction || own.axis.along == Vector3::zeros() {
            return None;
        }
        let end = Segment::new(own.axis.point(fraction), Vector3::zeros());
        match (side, shape) {
            (Side::A, CollisionShape::HalfSpace(half_space)) => {
                Some(from_half_space((&end, own.radius_m), half_space))
            }
            (Side::B, CollisionShape::HalfSpace(_)) => None,
            (Side::A, CollisionShape::Capsule(_)) => Some(apart((&end, own), (&second.axis, second))),
            (Side::B, CollisionShape::Capsule(_)) => Some(apart((&first.axis, first), (&end, own))),
        }
    })
}

/// Returns the distance of two objects whose axes are replaced.
fn apart((a, of_a): (&Segment, &Placed), (b, of_b): (&Segment, &Placed)) -> Proximity {
    between_capsules((a, of_a.radius_m), (b, of_b.radius_m), closest_fractions(a, b))
}
