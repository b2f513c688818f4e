//! Pose, velocity and acceleration of every body: forward kinematics to second order.
//!
//! RBDA §4.1 and the forward pass of table 5.1, in world axes; in Pinocchio `forwardKinematics`,
//! `getFrameVelocity`, and `getFrameClassicalAcceleration` with q̈ = 0.
//!
//! ```text
//! v_i = v_parent + S_i q̇          a_i = a_parent + v_i × S_i q̇
//! ```
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, frame_placement, frame_velocity, kinematics};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! let tool = model.frame_id("flange").expect("a link of the file");
//! let place = frame_placement(&model, &data, tool);
//! assert!(place.translation.norm() < 1.1, "within reach, m");
//! assert!(frame_velocity(&model, &data, tool).linear.norm() > 0.0);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::data::Data;
use crate::model::{Body, FrameId, JointKind, Model};
use crate::real::{self, Real};
use crate::spatial::{Motion, Placement, SpatialInertia};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

impl JointKind {
    /// Pose of the body at `x`, with its sine and cosine, in the frame in which `origin` is its pose at zero.
    #[inline]
    pub(crate) fn placement<T: Real>(self, origin: &Placement<T>, x: T, (s, c): (T, T)) -> Placement<T> {
        let rotation = &origin.rotation;
        match self {
            Self::Prismatic => {
                Placement { rotation: *rotation, translation: origin.translation + rotation.column(2) * x }
            }
            Self::Revolute | Self::Continuous => {
                let (x, y) = (rotation.column(0), rotation.column(1));
                let columns = [x * c + y * s, y * c - x * s, rotation.column(2).into_owned()];
                Placement { rotation: Matrix3::from_columns(&columns), translation: origin.translation }
            }
            // Placed by the quaternion of the whole base.
            Self::Floating => *origin,
        }
    }
}

/// Computes the pose of every body at `q` (nq; rad, m), [`Data::placement`], and its screw S, [`Data::screw`].
///
/// A revolute joint's screw is `[o × z; z]`, a prismatic one's `[z; 0]`, with z its axis and o its place
/// from [`Data::origin`].
///
/// Angles keep their digits up to 1e6 rad; beyond 1e15 rad rotations are meaningless. The quaternion of a floating base
/// is normalized; one of zeros gives NaN.
///
/// # Panics
/// If `q` is shorter than nq, or `data` is of a model with another number of bodies or joints.
pub fn forward_kinematics<T: Real>(model: &Model<T>, data: &mut Data<T>, q: &[T]) {
    assert!(data.placement.len() == model.bodies.len() && data.dq.len() == model.n(), "data of this model");
    let q = &q[..model.nq()];
    data.q.copy_from_slice(q);
    data.origin = model.base.translation;
    if model.floating {
        place_base(model, data, q);
    }
    // A quaternion has one number more than there are coordinates.
    let q = &q[usize::from(model.floating)..];
    let first = model.first_jointed_body();
    let Data { origin, placement, screw, angle, sin_cos, .. } = data;
    let jointed = &model.bodies[first..];
    for (angle, body) in angle[first..].iter_mut().zip(jointed) {
        *angle = body.ratio * q[body.joint] + body.offset;
    }
    for (sin_cos, &angle) in sin_cos.iter_mut().zip(angle.iter()) {
        *sin_cos = real::sin_cos(angle);
    }
    let moved = angle[first..].iter().zip(&sin_cos[first..]);
    for ((i, body), (&angle, &sin_cos)) in (first..).zip(jointed).zip(moved) {
        let parent = body.parent.map_or(&model.base, |p| &placement[p]);
        placement[i] = body.kind.placement(&(*parent * body.origin), angle, sin_cos);
    }
    for ((screw, place), body) in screw[first..].iter_mut().zip(&placement[first..]).zip(jointed) {
        *screw = body.screw(place, origin);
    }
}

impl<T: Real> Body<T> {
    /// Centre of mass of a body at `place`, from `origin`.
    #[inline]
    pub(crate) fn com(&self, place: &Placement<T>, origin: &Vector3<T>) -> Vector3<T> {
        place.act_point(&self.inertia.com) - origin
    }

    /// Inertia of a body at `place`, about `origin`.
    #[inline]
    pub(crate) fn spatial_inertia(&self, place: &Placement<T>, origin: &Vector3<T>) -> SpatialInertia<T> {
        SpatialInertia::new(&self.inertia, &place.rotation, &self.com(place, origin))
    }

    /// Screw S of a body at `place`.
    #[inline]
    fn screw(&self, place: &Placement<T>, origin: &Vector3<T>) -> Motion<T> {
        let along = place.rotation.column(2) * self.ratio;
        match self.kind {
            JointKind::Prismatic => Motion { linear: along, angular: Vector3::zeros() },
            _ => Motion { linear: (place.translation - origin).cross(&along), angular: along },
        }
    }
}

/// Places the six bodies of a floating base: all at its pose, with its axes for screws.
fn place_base<T: Real>(model: &Model<T>, data: &mut Data<T>, q: &[T]) {
    let place =
        model.base * Placement { rotation: rotation(&q[3..7]), translation: Vector3::new(q[0], q[1], q[2]) };
    data.origin = place.translation;
    for (i, placement) in data.placement[..6].iter_mut().enumerate() {
        *placement = place;
        let axis = place.rotation.column(i % 3).into_owned();
        data.screw[i] = if i < 3 {
            Motion { linear: axis, angular: Vector3::zeros() }
        } else {
            Motion { linear: Vector3::zeros(), angular: axis }
        };
    }
}

/// Rotation matrix of a unit quaternion x, y, z, w; one that is off by rounding is normalized first.
fn rotation<T: Real>(q: &[T]) -> Matrix3<T> {
    let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).simd_sqrt();
    let unit = Quaternion::new(q[3], q[0], q[1], q[2]) / length;
    UnitQuaternion::new_unchecked(unit).to_rotation_matrix().into_inner()
}

/// Computes [`forward_kinematics`] at `q` (nq; rad, m), and the velocity and velocity-product acceleration of every
/// body at `dq` (n; rad/s, m/s): [`Data::velocity`], [`Data::bias_acceleration`].
///
/// # Panics
/// If `q` is shorter than nq or `dq` than n.
pub fn kinematics<T: Real>(model: &Model<T>, data: &mut Data<T>, q: &[T], dq: &[T]) {
    forward_kinematics(model, data, q);
    data.dq.copy_from_slice(&dq[..model.n()]);
    let first = model.first_jointed_body();
    if model.floating {
        // One joint of six coordinates: all its screws move with it, and v × S q̇ = v × v = 0.
        let velocity = data.screw[..6].iter().zip(dq).fold(Motion::zero(), |v, (s, &x)| v + *s * x);
        data.velocity[..6].fill(velocity);
        data.bias_acceleration[..6].fill(Motion::zero());
    }
    for (i, body) in model.bodies.iter().enumerate().skip(first) {
        let own = data.screw[i] * dq[body.joint];
        let (velocity, bias) = match body.parent {
            None => (own, Motion::zero()),
            Some(p) => {
                let carried = &data.velocity[p];
                (*carried + own, data.bias_acceleration[p] + carried.cross_motion(&own))
            }
        };
        data.velocity[i] = velocity;
        data.bias_acceleration[i] = bias;
    }
}

/// Pose of a frame in the world. Needs [`forward_kinematics`].
#[must_use]
pub fn frame_placement<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Placement<T> {
    let frame = &model.frames[frame.0];
    frame.body.map_or(model.base, |b| data.placement[b]) * frame.placement
}

/// Velocity of a frame's origin (m/s) and of the frame (rad/s), in world axes. Needs [`kinematics`].
#[must_use]
pub fn frame_velocity<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Motion<T> {
    match model.frames[frame.0].body {
        None => Motion::zero(),
        Some(b) => data.velocity[b].shifted_to(&frame_point(model, data, frame)),
    }
}

/// Origin of a frame, from [`Data::origin`].
#[inline]
pub(crate) fn frame_point<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Vector3<T> {
    let frame = &model.frames[frame.0];
    let body = frame.body.map_or(&model.base, |b| &data.placement[b]);
    body.act_point(&frame.placement.translation) - data.origin
}

/// Classical acceleration J̇ q̇ of a frame with q̈ = 0, in world axes (m/s², rad/s²): its linear part
/// is the rate of change of the linear part of [`frame_velocity`]. Needs [`kinematics`].
#[must_use]
pub fn frame_bias_acceleration<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Motion<T> {
    let Some(b) = model.frames[frame.0].body else {
        return Motion::zero();
    };
    let point = frame_point(model, data, frame);
    let velocity = data.velocity[b].shifted_to(&point);
    let mut a = data.bias_acceleration[b].shifted_to(&point);
    // From the spatial acceleration to that of the point (RBDA eq. 2.48).
    a.linear += velocity.angular.cross(&velocity.linear);
    a
}
