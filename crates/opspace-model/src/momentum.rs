//! Generalised momentum, and the part of its rate that is due to velocities.
//!
//! ```text
//! p = M q̇        p_i = S_iᵀ h_i          ṗ = τ + Cᵀ q̇ − g          (Cᵀ q̇)_i = Ṡ_iᵀ h_i
//! ```
//!
//! h_i is the momentum of the subtree of body i. Cᵀ q̇ is the gradient ∂(½ q̇ᵀ M q̇)/∂q of the kinetic energy, with the
//! matrix C of [`coriolis`](crate::coriolis()). The second recursion follows from S_iᵀ ḣ_i = τ_i − g_i, so that one
//! pass over the bodies computes both, without M and without C. De Luca, Albu-Schäffer, Haddadin, Hirzinger, *Collision
//! detection and safe reaction with the DLR-III lightweight manipulator arm*, IROS 2006, needs both for its observer.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, generalized_momentum, update};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! assert!(update(&model, &mut data, &[0.1; 6], &[0.5; 6]));
//! generalized_momentum(&model, &mut data);
//! assert!((&data.momentum - &data.mass_matrix * &data.dq).norm() < 1e-12);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::data::Data;
use crate::jacobian::screw_rate;
use crate::model::Model;
use crate::real::Real;

/// Computes p = M q̇ into [`Data::momentum`] (n; Nms) and Cᵀ q̇ into [`Data::kinetic_energy_gradient`] (n; Nm). Needs
/// [`kinematics`](crate::kinematics()). Rotors add to the momentum only.
pub fn generalized_momentum<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    let bodies = model.bodies.iter().zip(&data.placement).zip(&data.velocity);
    for (momentum, ((body, place), velocity)) in data.force.iter_mut().zip(bodies) {
        *momentum = body.spatial_inertia(place, &data.origin).apply(velocity);
    }
    data.momentum.as_mut_slice().fill(T::zero());
    data.kinetic_energy_gradient.as_mut_slice().fill(T::zero());
    for (i, body) in model.bodies.iter().enumerate().rev() {
        let momentum = data.force[i];
        let (along, across) = (data.screw[i].dot(&momentum), screw_rate(data, i).dot(&momentum));
        data.momentum[body.joint] += along;
        data.kinetic_energy_gradient[body.joint] += across;
        if let Some(parent) = body.parent {
            data.force[parent] += &momentum;
        }
    }
    for ((momentum, &rotor), &dq) in data.momentum.iter_mut().zip(&model.rotor_inertia).zip(&data.dq) {
        *momentum += rotor * dq;
    }
}
