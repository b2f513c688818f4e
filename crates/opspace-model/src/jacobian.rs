//! Jacobians of frames, points and the centre of mass, and their time derivatives.
//!
//! Jacobians are 6 × n (3 × n for the centre of mass), with the linear rows first. They need
//! [`forward_kinematics`](crate::forward_kinematics); their time derivatives need [`kinematics`](crate::kinematics()).
//! In Pinocchio `getFrameJacobian` and `getFrameJacobianTimeVariation` with
//!
//! | here | Pinocchio's reference frame | velocity is that of |
//! |---|---|---|
//! | [`frame_jacobian`] | `LOCAL_WORLD_ALIGNED` | the frame's origin, in world axes |
//! | [`local_jacobian`] | `LOCAL` | the frame's origin, in the frame's axes |
//! | [`world_jacobian`] | `WORLD` | the body's point at the world's origin, in world axes |
//!
//! and `jacobianCenterOfMass` for [`com_jacobian`].
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, frame_jacobian, frame_velocity, kinematics};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! let tool = model.frame_id("flange").expect("a link of the file");
//! let mut jacobian = nalgebra::Matrix6xX::zeros(model.n());
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! frame_jacobian(&model, &data, tool, &mut jacobian);
//! let velocity = &jacobian * &data.dq;
//! let same = frame_velocity(&model, &data, tool);
//! assert!((velocity.fixed_rows::<3>(0) - same.linear).norm() < 1e-14);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::crba::composites;
use crate::data::Data;
use crate::kinematics::{frame_placement, frame_point, frame_velocity};
use crate::model::{FrameId, Model};
use crate::real::Real;
use crate::spatial::{Force, Motion};
use nalgebra::{Matrix3xX, Matrix6xX, Vector3};

/// Computes J (6 × n) with J q̇ = [`frame_velocity`]: in world axes, at the origin of the frame. The column of a
/// revolute joint is `[z × (p − o); z]`, that of a prismatic joint `[z; 0]`, with z the joint axis, o its origin and p
/// the origin of the frame.
///
/// # Panics
/// If `jacobian` does not have n columns.
pub fn frame_jacobian<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    frame: FrameId,
    jacobian: &mut Matrix6xX<T>,
) {
    let point = frame_point(model, data, frame);
    sum_columns(model, frame, jacobian, |i| data.screw[i].shifted_to(&point));
}

/// Computes the Jacobian (6 × n) of a point fixed in a frame, in world axes: linear velocity of the point and angular
/// velocity of the frame. `point` is given in the frame (m).
///
/// # Panics
/// If `jacobian` does not have n columns.
pub fn point_jacobian<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    frame: FrameId,
    point: &Vector3<T>,
    jacobian: &mut Matrix6xX<T>,
) {
    let point = frame_placement(model, data, frame).act_point(point) - data.origin;
    sum_columns(model, frame, jacobian, |i| data.screw[i].shifted_to(&point));
}

/// Computes [`frame_jacobian`] in the frame's own axes.
///
/// # Panics
/// If `jacobian` does not have n columns.
pub fn local_jacobian<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    frame: FrameId,
    jacobian: &mut Matrix6xX<T>,
) {
    let place = frame_placement(model, data, frame);
    let point = place.translation - data.origin;
    sum_columns(model, frame, jacobian, |i| {
        data.screw[i].shifted_to(&point).rotated_inverse(&place.rotation)
    });
}

/// Computes the spatial Jacobian, in world axes: linear velocity of the body point at the world origin, and angular
/// velocity.
///
/// # Panics
/// If `jacobian` does not have n columns.
pub fn world_jacobian<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    frame: FrameId,
    jacobian: &mut Matrix6xX<T>,
) {
    sum_columns(model, frame, jacobian, |i| data.screw[i].shifted_to(&-data.origin));
}

/// Computes the Jacobian of the motion of `frame` relative to `from`: the velocity of the origin of `frame` relative to
/// the moving frame `from`, and the relative angular velocity, in the axes of `from`. J_rel = R_fromᵀ (J of `frame` − J
/// of `from` at the same point).
///
/// # Panics
/// If `jacobian` does not have n columns.
pub fn relative_jacobian<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    from: FrameId,
    frame: FrameId,
    jacobian: &mut Matrix6xX<T>,
) {
    let axes = frame_placement(model, data, from).rotation;
    let point = frame_point(model, data, frame);
    let column = |i: usize| data.screw[i].shifted_to(&point).rotated_inverse(&axes);
    sum_columns(model, frame, jacobian, column);
    // Common ancestors cause no relative motion: their columns cancel exactly.
    for i in model.ancestors(from) {
        let column = -column(i);
        add(jacobian, model.bodies[i].joint, &column.linear, &column.angular);
    }
}

/// Computes J̇ of [`frame_jacobian`].
///
/// # Panics
/// If `rate` does not have n columns.
pub fn frame_jacobian_rate<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    frame: FrameId,
    rate: &mut Matrix6xX<T>,
) {
    let point = frame_point(model, data, frame);
    let velocity = frame_velocity(model, data, frame).linear;
    sum_columns(model, frame, rate, |i| rate_at(data, i, &point, &velocity));
}

/// Computes J̇ of [`local_jacobian`].
///
/// # Panics
/// If `rate` does not have n columns.
pub fn local_jacobian_rate<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    frame: FrameId,
    rate: &mut Matrix6xX<T>,
) {
    let place = frame_placement(model, data, frame);
    let point = place.translation - data.origin;
    let velocity = frame_velocity(model, data, frame);
    sum_columns(model, frame, rate, |i| {
        // The axes of the frame rotate too: d/dt (Rᵀ x) = Rᵀ (ẋ − ω × x).
        let column = data.screw[i].shifted_to(&point);
        let turning = Motion {
            linear: velocity.angular.cross(&column.linear),
            angular: velocity.angular.cross(&column.angular),
        };
        (rate_at(data, i, &point, &velocity.linear) - turning).rotated_inverse(&place.rotation)
    });
}

/// Computes J̇ of [`world_jacobian`].
///
/// # Panics
/// If `rate` does not have n columns.
pub fn world_jacobian_rate<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    frame: FrameId,
    rate: &mut Matrix6xX<T>,
) {
    sum_columns(model, frame, rate, |i| screw_rate(data, i).shifted_to(&-data.origin));
}

/// Computes J (3 × n) such that J q̇ is the velocity of the centre of mass of all moving bodies, in world axes. Zero if
/// the bodies have no mass.
///
/// # Panics
/// If `jacobian` does not have n columns.
pub fn com_jacobian<T: Real>(model: &Model<T>, data: &mut Data<T>, jacobian: &mut Matrix3xX<T>) {
    assert_eq!(jacobian.ncols(), model.n(), "one Jacobian column a joint");
    jacobian.as_mut_slice().fill(T::zero());
    composites(model, data);
    let mass = model.total_mass();
    let per_mass = (T::one() / mass).select(mass.simd_gt(T::zero()), T::zero());
    for (i, body) in model.bodies.iter().enumerate() {
        let momentum = data.composite[i].apply(&data.screw[i]).linear;
        let mut column = jacobian.column_mut(body.joint);
        column += momentum * per_mass;
    }
}

/// Adds Jᵀ f of the wrench f at a frame (in world axes, at its origin) to [`Data::torque`].
pub(crate) fn add_external<T: Real>(model: &Model<T>, data: &mut Data<T>, frame: FrameId, wrench: &Force<T>) {
    let point = frame_point(model, data, frame);
    for i in model.ancestors(frame) {
        data.torque[model.bodies[i].joint] += data.screw[i].shifted_to(&point).dot(wrench);
    }
}

/// Returns the time derivative of the screw of body i, Ṡ = v × S.
#[inline]
pub(crate) fn screw_rate<T: Real>(data: &Data<T>, i: usize) -> Motion<T> {
    data.velocity[i].cross_motion(&data.screw[i])
}

/// Returns the time derivative of the screw of body i at a moving point.
#[inline]
fn rate_at<T: Real>(data: &Data<T>, i: usize, point: &Vector3<T>, velocity: &Vector3<T>) -> Motion<T> {
    let mut rate = screw_rate(data, i).shifted_to(point);
    rate.linear += data.screw[i].angular.cross(velocity);
    rate
}

/// Writes the columns of all joints that move `frame`, and zeros for the other joints.
#[inline]
fn sum_columns<T: Real>(
    model: &Model<T>,
    frame: FrameId,
    jacobian: &mut Matrix6xX<T>,
    column: impl Fn(usize) -> Motion<T>,
) {
    assert_eq!(jacobian.ncols(), model.n(), "one Jacobian column a joint");
    jacobian.as_mut_slice().fill(T::zero());
    for i in model.ancestors(frame) {
        let column = column(i);
        add(jacobian, model.bodies[i].joint, &column.linear, &column.angular);
    }
}

/// Adds to the column of joint `joint`.
#[inline]
pub(crate) fn add<T: Real>(
    jacobian: &mut Matrix6xX<T>,
    joint: usize,
    linear: &Vector3<T>,
    angular: &Vector3<T>,
) {
    let (columns, _) = jacobian.as_mut_slice().as_chunks_mut::<6>();
    let column = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
    columns[joint].iter_mut().zip(column).for_each(|(sum, x)| *sum += x);
}
