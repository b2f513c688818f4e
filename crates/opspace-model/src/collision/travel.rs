//! Bounds on the change of a distance with the joint positions, for all postures.

use super::capsule::CollisionShape;
use super::model::CollisionModel;
use crate::model::{Body, JointKind, Model};
use nalgebra::Vector3;

impl CollisionModel {
    /// Writes, for each joint (n), an upper bound of the change of a pair's distance per change of the joint position, in
    /// all postures (1 for a joint in m, m/rad). Between the postures q₁ and q₂ the distance changes by at most
    /// Σ `bound`ᵢ |q₂ − q₁|ᵢ. The bound is the sum of the lengths between the joint and the farther end of a capsule's axis:
    /// the motion is longest when the chain between them is straight. Does not allocate.
    ///
    /// It is infinite if a joint can move the capsule arbitrarily far away: joints below a prismatic joint without limits,
    /// and all joints that move the pair if the base floats.
    ///
    /// # Panics
    /// If `bound` does not have n entries, or there is no such pair.
    pub fn distance_change_bound(&self, model: &Model, pair: usize, bound: &mut [f64]) {
        assert_eq!(bound.len(), model.n(), "one entry a joint");
        bound.fill(0.0);
        let pair = self.pairs[pair];
        let [mut a, mut b] = [pair.a, pair.b].map(|object| Side {
            body: self.objects[object].holder.body(),
            reach_m: farthest_m(&self.objects[object].shape),
        });
        while a.body != b.body {
            // The index of a parent is lower, and the base comes before all bodies.
            let side = if a.body > b.body { &mut a } else { &mut b };
            let Some(index) = side.body else { break };
            let body = &model.bodies[index];
            let lever = if body.kind == JointKind::Prismatic { 1.0 } else { side.reach_m };
            bound[body.joint] += body.ratio.abs() * if model.is_floating() { f64::INFINITY } else { lever };
            side.reach_m += body.origin.translation.norm() + slide_m(model, body);
            side.body = body.parent;
        }
    }
}

/// Object of a pair as seen from a body that carries it: largest distance of its axis from the origin of the body, m.
struct Side {
    body: Option<usize>,
    reach_m: f64,
}

/// Returns the distance of the farther end of a capsule's axis from the origin, m; 0 for a half-space, which no joint
/// moves.
fn farthest_m(shape: &CollisionShape) -> f64 {
    match shape {
        CollisionShape::Capsule(capsule) => {
            [capsule.start_m, capsule.end_m].iter().map(Vector3::norm).fold(0.0, f64::max)
        }
        CollisionShape::HalfSpace(_) => 0.0,
    }
}

/// Returns the longest way by which a joint shifts its body, m.
fn slide_m(model: &Model, body: &Body) -> f64 {
    if body.kind != JointKind::Prismatic {
        return 0.0;
    }
    let limits = &model.joints[body.joint].limits;
    body.ratio.abs() * limits.lower.abs().max(limits.upper.abs()) + body.offset.abs()
}
