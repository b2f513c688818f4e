//! Inverse dynamics by the recursive Newton–Euler algorithm.
//!
//! RBDA table 5.1; in Pinocchio `rnea`, `nonLinearEffects` and `computeGeneralizedGravity`.
//!
//! ```text
//! f_i = I_i a_i + v_i ×* I_i v_i          τ_i = S_iᵀ (sum of f over the subtree of i)
//! ```
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, bias, kinematics, rnea};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! rnea(&model, &mut data, &[0.0; 6]);
//! bias(&model, &mut data);
//! assert_eq!(data.torque, data.bias, "what the arm needs without accelerating, Nm");
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::data::Data;
use crate::jacobian::add_external;
use crate::model::{Body, FrameId, Model};
use crate::real::Real;
use crate::spatial::{Force, Motion, Placement, apply, apply_transposed};
use nalgebra::{DVector, Vector3};

/// Computes τ = M q̈ + C q̇ + g at `ddq` (n; rad/s²) into [`Data::torque`] (Nm). Needs
/// [`kinematics`](crate::kinematics()).
///
/// # Panics
/// If `ddq` is shorter than the number of joints.
pub fn rnea<T: Real>(model: &Model<T>, data: &mut Data<T>, ddq: &[T]) {
    let ddq = &ddq[..model.n()];
    accelerate(model, data, ddq);
    let Data { origin, placement, velocity, bias_acceleration, acceleration, force, .. } = data;
    let motions = velocity.iter().zip(bias_acceleration.iter().zip(acceleration.iter()));
    let bodies = model.bodies.iter().zip(placement.iter());
    for (force, ((body, place), (v, (bias, more)))) in force.iter_mut().zip(bodies.zip(motions)) {
        *force = newton_euler(body, place, origin, v, &(*bias + *more));
    }
    backward(model, &data.screw, &mut data.force, &mut data.torque);
    for ((torque, &rotor), &ddq) in data.torque.iter_mut().zip(&model.rotor_inertia).zip(ddq) {
        *torque += rotor * ddq;
    }
}

/// Computes τ = M q̈ + C q̇ + g − Σ Jᵀ f: [`rnea`] with wrenches f that act on the robot at frames (N, Nm; in world
/// axes, at the origin of each frame).
///
/// # Panics
/// If `ddq` is shorter than the number of joints.
pub fn rnea_external<T: Real>(
    model: &Model<T>,
    data: &mut Data<T>,
    ddq: &[T],
    wrenches: &[(FrameId, Force<T>)],
) {
    rnea(model, data, ddq);
    for (frame, wrench) in wrenches {
        add_external(model, data, *frame, &-*wrench);
    }
}

/// Computes the bias h = C q̇ + g, the torques at q̈ = 0, into [`Data::bias`] (Nm). Needs
/// [`kinematics`](crate::kinematics()).
pub fn bias<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    let Data { origin, placement, velocity, bias_acceleration, force, .. } = data;
    let motions = velocity.iter().zip(bias_acceleration.iter());
    let bodies = model.bodies.iter().zip(placement.iter());
    for (force, ((body, place), (v, bias))) in force.iter_mut().zip(bodies.zip(motions)) {
        let a = Motion { linear: bias.linear - model.gravity, angular: bias.angular };
        *force = newton_euler(body, place, origin, v, &a);
    }
    backward(model, &data.screw, &mut data.force, &mut data.bias);
}

/// Computes g, the torques that hold the robot at rest, into [`Data::gravity`] (Nm). Needs
/// [`forward_kinematics`](crate::forward_kinematics).
pub fn gravity<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    for (force, (body, place)) in data.force.iter_mut().zip(model.bodies.iter().zip(&data.placement)) {
        let com = body.com(place, &data.origin);
        let linear = model.gravity * -body.inertia.mass;
        *force = Force { linear, angular: com.cross(&linear) };
    }
    backward(model, &data.screw, &mut data.force, &mut data.gravity);
}

/// Computes [`bias`] from the spatial inertias of the bodies in `composite`.
pub(crate) fn bias_of_bodies<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    let Data { composite, velocity, bias_acceleration, force, .. } = data;
    for (force, (inertia, (v, bias))) in
        force.iter_mut().zip(composite.iter().zip(velocity.iter().zip(bias_acceleration.iter())))
    {
        let a = Motion { linear: bias.linear - model.gravity, angular: bias.angular };
        let (rate, turned) = (inertia.apply(&a), v.cross_force(&inertia.apply(v)));
        *force = Force { linear: rate.linear + turned.linear, angular: rate.angular + turned.angular };
    }
    backward(model, &data.screw, &mut data.force, &mut data.bias);
}

/// Computes [`gravity`] from the composite inertias that [`crba`](crate::crba) computes.
pub(crate) fn gravity_of_composites<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    let up = -model.gravity;
    data.gravity.as_mut_slice().fill(T::zero());
    for ((body, screw), carried) in model.bodies.iter().zip(&data.screw).zip(&data.composite) {
        let weight = Force { linear: up * carried.mass, angular: carried.first_moment.cross(&up) };
        data.gravity[body.joint] += screw.dot(&weight);
    }
}

/// Computes the part of each body's acceleration that is due to `ddq` and gravity; the bias acceleration is not
/// included. Gravity is modelled as an upward acceleration of the base.
#[inline]
pub(crate) fn accelerate<T: Real>(model: &Model<T>, data: &mut Data<T>, ddq: &[T]) {
    for (i, body) in model.bodies.iter().enumerate() {
        let carried = match body.parent {
            None => Motion { linear: -model.gravity, angular: Vector3::zeros() },
            Some(p) => data.acceleration[p],
        };
        data.acceleration[i] = carried + data.screw[i] * ddq[body.joint];
    }
}

/// Returns the net force on a body, f = I a + v ×* I v (RBDA eq. 2.72), in world axes about `origin`.
///
/// Newton's equation is evaluated for the centre of mass in world axes, Euler's equation about the centre of mass in
/// body axes, in which the inertia is constant.
#[inline(always)]
fn newton_euler<T: Real>(
    body: &Body<T>,
    placement: &Placement<T>,
    origin: &Vector3<T>,
    v: &Motion<T>,
    a: &Motion<T>,
) -> Force<T> {
    let Placement { rotation, .. } = placement;
    let com = body.com(placement, origin);
    let linear =
        (a.shifted_to(&com).linear + v.angular.cross(&v.shifted_to(&com).linear)) * body.inertia.mass;
    let (w, alpha) = (apply_transposed(rotation, &v.angular), apply_transposed(rotation, &a.angular));
    let inertia = &body.inertia.rotational;
    let moment = apply(inertia, &alpha) + w.cross(&apply(inertia, &w));
    Force { linear, angular: apply(rotation, &moment) + com.cross(&linear) }
}

/// Sums the forces from the tips to the base: each joint transmits the forces on its body and on all descendants of its
/// body.
#[inline]
fn backward<T: Real>(model: &Model<T>, screw: &[Motion<T>], force: &mut [Force<T>], torque: &mut DVector<T>) {
    torque.as_mut_slice().fill(T::zero());
    for (i, body) in model.bodies.iter().enumerate().rev() {
        let (before, carried) = force.split_at_mut(i);
        torque[body.joint] += screw[i].dot(&carried[0]);
        if let Some(p) = body.parent {
            before[p] += &carried[0];
        }
    }
}
