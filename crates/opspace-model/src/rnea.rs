//! Inverse dynamics: the torques that a motion needs, by the recursive Newton–Euler algorithm.
//!
//! RBDA table 5.1; in Pinocchio `rnea`, `nonLinearEffects` and `computeGeneralizedGravity`. All three
//! need [`kinematics`](crate::kinematics()).

use crate::data::Data;
use crate::model::Model;
use crate::spatial::Motion;
use nalgebra::Vector3;

/// τ = M q̈ + C q̇ + g at `ddq` (n; rad/s²), into [`Data::torque`] (Nm).
///
/// # Panics
/// If `ddq` is shorter than the number of joints.
pub fn rnea(model: &Model, data: &mut Data, ddq: &[f64]) {
    for (i, joint) in model.joints.iter().enumerate() {
        let own = joint.kind.motion(ddq[i]);
        data.acceleration[i] = match joint.parent {
            None => own,
            Some(p) => data.placement_parent[i].act_inverse_motion(&data.acceleration[p]) + own,
        };
        let a = data.acceleration[i] + data.bias_acceleration[i] + upward(model, data, i);
        data.force[i] = newton_euler(model, data, i, &a);
    }
    backward(model, data);
    for (i, joint) in model.joints.iter().enumerate() {
        data.torque[i] = joint.kind.project(&data.force[i]) + joint.rotor_inertia * ddq[i];
    }
}

/// h = C q̇ + g, the torques at q̈ = 0, into [`Data::bias`] (Nm).
pub fn bias(model: &Model, data: &mut Data) {
    for i in 0..model.n() {
        let a = data.bias_acceleration[i] + upward(model, data, i);
        data.force[i] = newton_euler(model, data, i, &a);
    }
    backward(model, data);
    for (i, joint) in model.joints.iter().enumerate() {
        data.bias[i] = joint.kind.project(&data.force[i]);
    }
}

/// g, the torques that hold the robot still, into [`Data::gravity`] (Nm).
pub fn gravity(model: &Model, data: &mut Data) {
    for (i, joint) in model.joints.iter().enumerate() {
        data.force[i] = joint.inertia.apply(&upward(model, data, i));
    }
    backward(model, data);
    for (i, joint) in model.joints.iter().enumerate() {
        data.gravity[i] = joint.kind.project(&data.force[i]);
    }
}

/// Gravity as what it feels like: the whole robot accelerating upwards. In body i's axes.
#[inline]
fn upward(model: &Model, data: &Data, i: usize) -> Motion {
    let linear = data.placement_world[i].rotation.tr_mul(&-model.gravity);
    Motion { linear, angular: Vector3::zeros() }
}

/// f = I a + v ×* I v: the net force on body i (RBDA eq. 2.72).
#[inline]
fn newton_euler(model: &Model, data: &Data, i: usize, a: &Motion) -> crate::spatial::Force {
    let inertia = &model.joints[i].inertia;
    let v = &data.velocity[i];
    inertia.apply(a) + v.cross_force(&inertia.apply(v))
}

/// Each joint carries its own body and all bodies beyond: forces summed from the tips to the base.
fn backward(model: &Model, data: &mut Data) {
    for i in (0..model.n()).rev() {
        if let Some(p) = model.joints[i].parent {
            let carried = data.placement_parent[i].act_force(&data.force[i]);
            data.force[p] += carried;
        }
    }
}
