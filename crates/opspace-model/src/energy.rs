//! Energies and the centre of mass.
//!
//! In Pinocchio `computeKineticEnergy`, `computePotentialEnergy` and `centerOfMass`. All need
//! [`kinematics`](crate::kinematics()).

use crate::data::Data;
use crate::model::Model;
use nalgebra::Vector3;

/// ½ q̇ᵀ M q̇, rotors included, J.
#[must_use]
pub fn kinetic_energy(model: &Model, data: &Data) -> f64 {
    let twice: f64 = (model.joints.iter().enumerate())
        .map(|(i, joint)| {
            let v = &data.velocity[i];
            v.dot(&joint.inertia.apply(v)) + joint.rotor_inertia * data.dq[i] * data.dq[i]
        })
        .sum();
    0.5 * twice
}

/// The work against gravity from the plane through the world's origin, J.
#[must_use]
pub fn potential_energy(model: &Model, data: &Data) -> f64 {
    -model.gravity.dot(&first_moment(model, data))
}

/// The centre of mass of all moving bodies in the world, m; `None` if they weigh nothing.
#[must_use]
pub fn center_of_mass(model: &Model, data: &Data) -> Option<Vector3<f64>> {
    let mass = model.total_mass();
    (mass > 0.0).then(|| first_moment(model, data) / mass)
}

/// Σ m c, kg m.
fn first_moment(model: &Model, data: &Data) -> Vector3<f64> {
    (model.joints.iter().zip(&data.placement_world))
        .map(|(joint, placement)| placement.act_point(&joint.inertia.com) * joint.inertia.mass)
        .sum()
}
