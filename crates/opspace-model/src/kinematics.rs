//! Where every body is and how it moves: forward kinematics to second order.
//!
//! RBDA §4.1 and the forward pass of table 5.1; in Pinocchio `forwardKinematics` and
//! `getFrameVelocity`, `getFrameClassicalAcceleration` with q̈ = 0.

use crate::data::Data;
use crate::model::{FrameId, JointKind, Model};
use crate::spatial::{Motion, Placement};
use nalgebra::{Matrix3, Vector3};

impl JointKind {
    /// The pose of the body at `q` in its frame at q = 0, after `origin`.
    #[inline]
    pub(crate) fn placement(self, origin: &Placement, q: f64) -> Placement {
        match self {
            Self::Prismatic => Placement {
                rotation: origin.rotation,
                translation: origin.translation + origin.rotation.column(2) * q,
            },
            Self::Revolute | Self::Continuous => {
                let (s, c) = q.sin_cos();
                let (x, y) = (origin.rotation.column(0), origin.rotation.column(1));
                let rotation = Matrix3::from_columns(&[
                    x * c + y * s,
                    y * c - x * s,
                    origin.rotation.column(2).into_owned(),
                ]);
                Placement { rotation, translation: origin.translation }
            }
        }
    }

    /// S x: the motion of the body when the joint moves at `x`.
    #[inline]
    pub(crate) fn motion(self, x: f64) -> Motion {
        let along = Vector3::new(0.0, 0.0, x);
        match self {
            Self::Prismatic => Motion { linear: along, angular: Vector3::zeros() },
            Self::Revolute | Self::Continuous => Motion { linear: Vector3::zeros(), angular: along },
        }
    }

    /// Sᵀ f: what the joint feels of a force on its body.
    #[inline]
    pub(crate) fn project(self, f: &crate::spatial::Force) -> f64 {
        match self {
            Self::Prismatic => f.linear.z,
            Self::Revolute | Self::Continuous => f.angular.z,
        }
    }
}

/// Places every body at `q` (n; rad, m) and finds its velocity and velocity-product acceleration at
/// `dq` (n; rad/s, m/s).
///
/// ```text
/// v_i = X v_parent + S q̇_i          a_i = X a_parent + v_i × S q̇_i
/// ```
///
/// # Panics
/// If `q` or `dq` is shorter than the number of joints.
pub fn kinematics(model: &Model, data: &mut Data, q: &[f64], dq: &[f64]) {
    let n = model.n();
    let (q, dq) = (&q[..n], &dq[..n]);
    data.q.copy_from_slice(q);
    data.dq.copy_from_slice(dq);
    for (i, joint) in model.joints.iter().enumerate() {
        let placement = joint.kind.placement(&joint.origin, q[i]);
        let own = joint.kind.motion(dq[i]);
        let (world, velocity, bias) = match joint.parent {
            None => (model.base * placement, own, Motion::zero()),
            Some(p) => {
                let velocity = placement.act_inverse_motion(&data.velocity[p]) + own;
                let carried = placement.act_inverse_motion(&data.bias_acceleration[p]);
                (data.placement_world[p] * placement, velocity, carried + velocity.cross_motion(&own))
            }
        };
        data.placement_parent[i] = placement;
        data.placement_world[i] = world;
        data.velocity[i] = velocity;
        data.bias_acceleration[i] = bias;
    }
}

/// The pose of a frame in the world. Needs [`kinematics`].
#[must_use]
pub fn frame_placement(model: &Model, data: &Data, frame: FrameId) -> Placement {
    let frame = &model.frames[frame.0];
    match frame.joint {
        None => model.base * frame.placement,
        Some(j) => data.placement_world[j] * frame.placement,
    }
}

/// The velocity of a frame's origin (m/s) and of the frame (rad/s), in world axes. Needs [`kinematics`].
#[must_use]
pub fn frame_velocity(model: &Model, data: &Data, frame: FrameId) -> Motion {
    let frame = &model.frames[frame.0];
    let Some(j) = frame.joint else {
        return Motion::zero();
    };
    to_world(data, j, &velocity_at(&data.velocity[j], &frame.placement.translation))
}

/// J̇ q̇: the classical acceleration of a frame with q̈ = 0, in world axes (m/s², rad/s²): its linear part
/// is the rate of change of the linear part of [`frame_velocity`]. Needs [`kinematics`].
#[must_use]
pub fn frame_bias_acceleration(model: &Model, data: &Data, frame: FrameId) -> Motion {
    let frame = &model.frames[frame.0];
    let Some(j) = frame.joint else {
        return Motion::zero();
    };
    let velocity = velocity_at(&data.velocity[j], &frame.placement.translation);
    let mut a = velocity_at(&data.bias_acceleration[j], &frame.placement.translation);
    // From the spatial acceleration to that of the point (RBDA eq. 2.48).
    a.linear += velocity.angular.cross(&velocity.linear);
    to_world(data, j, &a)
}

/// A body's motion at another of its points, in the body's axes.
fn velocity_at(m: &Motion, point: &Vector3<f64>) -> Motion {
    Motion { linear: m.linear + m.angular.cross(point), angular: m.angular }
}

fn to_world(data: &Data, body: usize, m: &Motion) -> Motion {
    let rotation = &data.placement_world[body].rotation;
    Motion { linear: rotation * m.linear, angular: rotation * m.angular }
}
