//! Kinetic and potential energy, and the centre of mass.
//!
//! In Pinocchio `computeKineticEnergy`, `computePotentialEnergy` and `centerOfMass`.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, center_of_mass, kinematics, kinetic_energy, potential_energy};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! assert!(kinetic_energy(&model, &data) > 0.0);
//! let com = center_of_mass(&model, &data).expect("the arm has mass");
//! let weight = model.total_mass() * 9.81;
//! assert!((potential_energy(&model, &data) - weight * com.z).abs() < 1e-12);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::data::Data;
use crate::model::Model;
use crate::real::Real;
use crate::spatial::{Force, Motion};
use nalgebra::Vector3;

/// Returns the kinetic energy ½ q̇ᵀ M q̇, including rotors, J. Needs [`kinematics`](crate::kinematics()).
#[must_use]
pub fn kinetic_energy<T: Real>(model: &Model<T>, data: &Data<T>) -> T {
    let mut twice = T::zero();
    for (i, v) in data.velocity.iter().enumerate() {
        twice += v.dot(&momentum(model, data, i, v));
    }
    for (&rotor, &dq) in model.rotor_inertia.iter().zip(&data.dq) {
        twice += rotor * dq * dq;
    }
    twice * T::splat(0.5)
}

/// Returns the momentum of body i with velocity `v`, about [`Data::origin`].
#[inline]
pub(crate) fn momentum<T: Real>(model: &Model<T>, data: &Data<T>, i: usize, v: &Motion<T>) -> Force<T> {
    model.bodies[i].spatial_inertia(&data.placement[i], &data.origin).apply(v)
}

/// Returns the potential energy in the gravity field, J; zero if the centre of mass is at the world origin. Needs
/// [`forward_kinematics`](crate::forward_kinematics).
#[must_use]
pub fn potential_energy<T: Real>(model: &Model<T>, data: &Data<T>) -> T {
    -model.gravity.dot(&first_moment(model, data))
}

/// Returns the centre of mass of all moving bodies in the world, m; `None` if they have no mass. Needs
/// [`forward_kinematics`](crate::forward_kinematics).
#[must_use]
pub fn center_of_mass<T: Real>(model: &Model<T>, data: &Data<T>) -> Option<Vector3<T>> {
    let mass = model.total_mass();
    (mass != T::zero()).then(|| first_moment(model, data) / mass)
}

/// Returns the velocity of the centre of mass (m/s, world axes); zero if the bodies have no mass. Needs
/// [`kinematics`](crate::kinematics()).
#[must_use]
pub fn com_velocity<T: Real>(model: &Model<T>, data: &Data<T>) -> Vector3<T> {
    mean_over_mass(model, data, |body, com| data.velocity[body].shifted_to(com).linear)
}

/// Returns the acceleration J̇ q̇ of the centre of mass for q̈ = 0 (m/s², world axes); zero if the bodies have no mass.
/// Needs [`kinematics`](crate::kinematics()).
#[must_use]
pub fn com_bias_acceleration<T: Real>(model: &Model<T>, data: &Data<T>) -> Vector3<T> {
    mean_over_mass(model, data, |body, com| {
        let velocity = data.velocity[body].shifted_to(com);
        data.bias_acceleration[body].shifted_to(com).linear + velocity.angular.cross(&velocity.linear)
    })
}

/// Returns the mass-weighted mean of a vector of each body. `of` receives the index of the body and its centre of mass
/// relative to [`Data::origin`].
fn mean_over_mass<T: Real>(
    model: &Model<T>,
    data: &Data<T>,
    of: impl Fn(usize, &Vector3<T>) -> Vector3<T>,
) -> Vector3<T> {
    let mass = model.total_mass();
    let per_mass = (T::one() / mass).select(mass.simd_gt(T::zero()), T::zero());
    let mut sum = Vector3::zeros();
    for (i, (body, placement)) in model.bodies.iter().zip(&data.placement).enumerate() {
        let com = placement.act_point(&body.inertia.com) - data.origin;
        sum += of(i, &com) * (body.inertia.mass * per_mass);
    }
    sum
}

/// Returns the first moment of mass Σ m c, kg m.
fn first_moment<T: Real>(model: &Model<T>, data: &Data<T>) -> Vector3<T> {
    let mut sum = Vector3::zeros();
    for (body, placement) in model.bodies.iter().zip(&data.placement) {
        sum += placement.act_point(&body.inertia.com) * body.inertia.mass;
    }
    sum
}
