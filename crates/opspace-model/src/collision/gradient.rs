//! Gradient of a distance with respect to the joint positions, and its second time derivative at zero joint
//! acceleration.

use super::model::{CollisionModel, Holder};
use super::proximity::{Axes, INTERSECTING_M, Proximity};
use super::segment::PARALLEL;
use crate::data::Data;
use crate::model::Model;
use crate::spatial::{Force, Motion};
use nalgebra::Vector3;

/// Computes the gradient (n; 1 for a joint in m, m/rad) of the distance of a pair with respect to the joint positions:
/// nᵀ (J_a − J_b), with the normal n and the Jacobians of the closest points. Then gradientᵀ q̇ is the rate of the
/// distance. `proximity` is that of the pair, by [`collision_distances`](super::collision_distances), in the same
/// state. Does not allocate.
///
/// Sliding of the closest points along the surfaces does not contribute, as their distance is the smallest. At a state
/// in which the closest points jump (parallel axes), the gradient is that of the points in `proximity`; if the axes
/// intersect, it is that of the normal in `proximity`, along which the depth decreases.
///
/// # Panics
/// If `gradient` does not have n entries, or there is no such pair.
pub fn distance_gradient(
    collision: &CollisionModel,
    model: &Model,
    data: &Data,
    pair: usize,
    proximity: &Proximity,
    gradient: &mut [f64],
) {
    assert_eq!(gradient.len(), model.n(), "one entry a joint");
    gradient.fill(0.0);
    // Force on a along the normal, and its reaction on b: the gradient is their generalized force. Both act along one
    // line, so that they have the same moment, and cancel exactly at common ancestors.
    let moment = (proximity.point_a_m - data.origin).cross(&proximity.normal);
    let force = Force { linear: proximity.normal, angular: moment };
    let pair = collision.pairs[pair];
    let mut a = collision.objects[pair.a].holder.body();
    let mut b = collision.objects[pair.b].holder.body();
    while a != b {
        // The index of a parent is lower, and the base comes before all bodies.
        let (above, sign) = if a > b { (&mut a, 1.0) } else { (&mut b, -1.0) };
        let Some(body) = *above else { break };
        gradient[model.bodies[body].joint] += sign * data.screw[body].dot(&force);
        *above = model.bodies[body].parent;
    }
}

/// Returns the second time derivative of the distance of a pair for q̈ = 0, m/s². For other accelerations it is
/// gradientᵀ q̈ plus this value. Needs [`kinematics`](crate::kinematics()). `proximity` is that of the pair, by
/// [`collision_distances`](super::collision_distances), in the same state. Does not allocate.
///
/// With w the vector from the closest point of axis b to that of axis a, fixed in their bodies, d = |w|, n = w/d, and
/// ẇ⊥ the part of ẇ across n,
///
/// d̈ = nᵀẅ + (|ẇ⊥|² − hᵀH⁻¹h) / d.
///
/// The first term contains J̇ q̇ of both points, |ẇ⊥|²/d is the rotation of the normal, and the last term the sliding
/// of the closest points along the axes: H is the Hessian of ½|w|² with respect to the positions on the axes, h the
/// time derivative of its gradient, for those axes on which the closest point is not an end. This is the second
/// derivative of a minimum over parameters, by the implicit function theorem.
///
/// The value is exact where the distance is twice differentiable. Where a closest point reaches or leaves an end, d̈
/// jumps, and the value is that of one side. For parallel axes, the point of a slides and that of b does not. If the
/// axes are closer than 1e-10 m, only the first term is computed.
///
/// It is not bounded: when axes are close to each other, the rotation of the normal makes it large and positive; when
/// they are almost parallel, fast sliding makes it large and negative. A limit needs a bound of its own for it.
#[must_use]
pub fn distance_bias_acceleration(
    collision: &CollisionModel,
    data: &Data,
    pair: usize,
    proximity: &Proximity,
) -> f64 {
    let pair = collision.pairs[pair];
    let (a, b) = (collision.objects[pair.a].holder, collision.objects[pair.b].holder);
    let normal = proximity.normal;
    let Some(Axes { along_a, along_b, apart_m }) = proximity.axes else {
        // The normal of a half-space is constant, and the closest point an end.
        return normal.dot(&PointMotion::new(data, a, &proximity.axis_points[0]).acceleration);
    };
    let [point_a, point_b] = proximity.axis_points;
    let (a, b) = (PointMotion::new(data, a, &point_a), PointMotion::new(data, b, &point_b));
    let direct = normal.dot(&(a.acceleration - b.acceleration));
    if apart_m <= INTERSECTING_M {
        return direct;
    }
    let velocity = a.velocity - b.velocity;
    let across = velocity - normal * normal.dot(&velocity);
    let apart = normal * apart_m;
    let rate_a = across.dot(&along_a) + apart.dot(&a.angular.cross(&along_a));
    let rate_b = -across.dot(&along_b) - apart.dot(&b.angular.cross(&along_b));
    let slides = proximity.fractions.map(|fraction| fraction > 0.0 && fraction < 1.0);
    let sliding = sliding_term([&along_a, &along_b], [rate_a, rate_b], slides);
    direct + (across.norm_squared() - sliding) / apart_m
}

/// Returns hᵀH⁻¹h for the axes along which the closest points slide.
#[inline]
fn sliding_term([a, b]: [&Vector3<f64>; 2], [rate_a, rate_b]: [f64; 2], slides: [bool; 2]) -> f64 {
    let (square_a, square_b) = (a.norm_squared(), b.norm_squared());
    match slides {
        [false, false] => 0.0,
        [false, true] => rate_b * rate_b / square_b,
        [true, false] => rate_a * rate_a / square_a,
        [true, true] => {
            // The determinant of H = [a·a, −a·b; −a·b, b·b].
            let determinant = a.cross(b).norm_squared();
            if determinant <= PARALLEL * PARALLEL * square_a * square_b {
                return rate_a * rate_a / square_a;
            }
            let mixed = 2.0 * a.dot(b) * rate_a * rate_b;
            (square_b * rate_a * rate_a + mixed + square_a * rate_b * rate_b) / determinant
        }
    }
}

/// Motion of a point that is fixed to an object, for q̈ = 0, in world axes: m/s, rad/s and m/s².
struct PointMotion {
    velocity: Vector3<f64>,
    angular: Vector3<f64>,
    acceleration: Vector3<f64>,
}

impl PointMotion {
    #[inline]
    fn new(data: &Data, holder: Holder, point: &Vector3<f64>) -> Self {
        let Some(body) = holder.body() else {
            let zero = Vector3::zeros();
            return Self { velocity: zero, angular: zero, acceleration: zero };
        };
        let point = point - data.origin;
        let Motion { linear: velocity, angular } = data.velocity[body].shifted_to(&point);
        let spatial = data.bias_acceleration[body].shifted_to(&point);
        // The classical acceleration of the point (RBDA eq. 2.48).
        Self { velocity, angular, acceleration: spatial.linear + angular.cross(&velocity) }
    }
}
