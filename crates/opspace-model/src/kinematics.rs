//! Forward kinematics to second order: pose, velocity and acceleration of every body.
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
    /// Returns the pose of the body at joint position `x` (rad or m, with its sine and cosine). `origin` is the pose at
    /// joint position zero; both poses are in the same frame.
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
            // The pose of a floating base is set by `place_base`.
            Self::Floating => *origin,
        }
    }
}

/// Computes the pose [`Data::placement`] and the screw S, [`Data::screw`], of every body at `q` (nq; rad, m).
///
/// The screw of a revolute joint is `[o × z; z]`, that of a prismatic joint `[z; 0]`, with z the joint axis and o its
/// position relative to [`Data::origin`]. The screw of a mimic joint is multiplied by its ratio.
///
/// Results are accurate to rounding for angles up to 1e6 rad; beyond 1e15 rad rotations are meaningless. The quaternion
/// of a floating base is normalized; a zero quaternion gives NaN.
///
/// # Panics
/// If `q` is shorter than nq, or if `data` belongs to a model with another number of bodies or joints.
pub fn forward_kinematics<T: Real>(model: &Model<T>, data: &mut Data<T>, q: &[T]) {
    assert!(data.placement.len() == model.bodies.len() && data.dq.len() == model.n(), "data of this model");
    let q = &q[..model.nq()];
    data.q.copy_from_slice(q);
    data.origin = model.base.translation;
    if model.floating {
        place_base(model, data, q);
    }
    // The quaternion of a floating base has one entry more than its angular velocity.
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
    /// Returns the centre of mass of a body with pose `place`, relative to `origin` (m, world axes).
    #[inline]
    pub(crate) fn com(&self, place: &Placement<T>, origin: &Vector3<T>) -> Vector3<T> {
        place.act_point(&self.inertia.com) - origin
    }

    /// Returns the inertia of a body with pose `place`, about `origin`.
    #[inline]
    pub(crate) fn spatial_inertia(&self, place: &Placement<T>, origin: &Vector3<T>) -> SpatialInertia<T> {
        SpatialInertia::new(&self.inertia, &place.rotation, &self.com(place, origin))
    }

    /// Returns the screw S of a body with pose `place`.
    #[inline]
    fn screw(&self, place: &Placement<T>, origin: &Vector3<T>) -> Motion<T> {
        let along = place.rotation.column(2) * self.ratio;
        match self.kind {
            JointKind::Prismatic => Motion { linear: along, angular: Vector3::zeros() },
            _ => Motion { linear: (place.translation - origin).cross(&along), angular: along },
        }
    }
}

/// Sets the poses and screws of the six bodies of a floating base. All six have the pose of the base; their screws are
/// its axes.
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

/// Returns the rotation matrix of the quaternion x, y, z, w, after normalization.
fn rotation<T: Real>(q: &[T]) -> Matrix3<T> {
    let length = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).simd_sqrt();
    let unit = Quaternion::new(q[3], q[0], q[1], q[2]) / length;
    UnitQuaternion::new_unchecked(unit).to_rotation_matrix().into_inner()
}

/// Computes [`forward_kinematics`] at `q` (nq; rad, m), and the velocity [`Data::velocity`] and velocity-product
/// acceleration [`Data::bias_acceleration`] of every body at `dq` (n; rad/s, m/s).
///
/// # Panics
/// If `q` is shorter than nq or `dq` than n.
pub fn kinematics<T: Real>(model: &Model<T>, data: &mut Data<T>, q: &[T], dq: &[T]) {
    forward_kinematics(model, data, q);
    data.dq.copy_from_slice(&dq[..model.n()]);
    let first = model.first_jointed_body();
    if model.floating {
        // The base is one joint with six coordinates. Its screws move with it, and v × S q̇ = v × v = 0.
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

/// Returns the pose of a frame in the world. Needs [`forward_kinematics`].
#[must_use]
pub fn frame_placement<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Placement<T> {
    let frame = &model.frames[frame.0];
    frame.body.map_or(model.base, |b| data.placement[b]) * frame.placement
}

/// Returns the velocity of a frame: linear velocity of its origin (m/s) and angular velocity (rad/s), in world axes.
/// Needs [`kinematics`].
#[must_use]
pub fn frame_velocity<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Motion<T> {
    match model.frames[frame.0].body {
        None => Motion::zero(),
        Some(b) => data.velocity[b].shifted_to(&frame_point(model, data, frame)),
    }
}

/// Returns the origin of a frame relative to [`Data::origin`] (m, world axes).
#[inline]
pub(crate) fn frame_point<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Vector3<T> {
    let frame = &model.frames[frame.0];
    let body = frame.body.map_or(&model.base, |b| &data.placement[b]);
    body.act_point(&frame.placement.translation) - data.origin
}

/// Returns the classical acceleration J̇ q̇ of a frame for q̈ = 0, in world axes (m/s², rad/s²). Its linear part is the
/// time derivative of the linear part of [`frame_velocity`]. Needs [`kinematics`].
#[must_use]
pub fn frame_bias_acceleration<T: Real>(model: &Model<T>, data: &Data<T>, frame: FrameId) -> Motion<T> {
    let Some(b) = model.frames[frame.0].body else {
        return Motion::zero();
    };
    let point = frame_point(model, data, frame);
    let velocity = data.velocity[b].shifted_to(&point);
    let mut a = data.bias_acceleration[b].shifted_to(&point);
    // Converts the spatial acceleration to the classical acceleration of the point (RBDA eq. 2.48).
    a.linear += velocity.angular.cross(&velocity.linear);
    a
}
