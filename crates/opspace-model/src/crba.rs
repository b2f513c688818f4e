//! Mass matrix by the composite-rigid-body algorithm.
//!
//! RBDA table 6.2; in Pinocchio `crba`.
//!
//! ```text
//! I_i = sum of the inertias over the subtree of i          M_ij = S_jᵀ I_i S_i  where j is an ancestor of i
//! ```
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, crba, forward_kinematics};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! forward_kinematics(&model, &mut data, &[0.1; 6]);
//! crba(&model, &mut data);
//! assert_eq!(data.mass_matrix, data.mass_matrix.transpose());
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::data::Data;
use crate::model::Model;
use crate::real::Real;

/// Computes M(q), with the rotor inertias on its diagonal, into [`Data::mass_matrix`] (n × n, full, kg m²). Needs
/// [`forward_kinematics`](crate::forward_kinematics).
///
/// Column i contains the torques of all joints while only joint i accelerates, at 1 rad/s². Joint i moves its subtree
/// as one rigid body, and only the ancestors of joint i transmit the resulting force.
pub fn crba<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    composites(model, data);
    mass_matrix(model, data);
}

/// Computes M from the composite inertias.
#[inline]
pub(crate) fn mass_matrix<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    let mass_matrix = &mut data.mass_matrix;
    mass_matrix.as_mut_slice().fill(T::zero());
    for (i, body) in model.bodies.iter().enumerate() {
        let force = data.composite[i].apply(&data.screw[i]);
        mass_matrix[(body.joint, body.joint)] += data.screw[i].dot(&force);
        for j in model.ancestry(body.parent) {
            let entry = data.screw[j].dot(&force);
            let ancestor = model.bodies[j].joint;
            mass_matrix[(body.joint, ancestor)] += entry;
            mass_matrix[(ancestor, body.joint)] += entry;
        }
    }
    for (i, &rotor) in model.rotor_inertia.iter().enumerate() {
        mass_matrix[(i, i)] += rotor;
    }
}

/// Computes the composite inertia of every body: the sum of its own inertia and the inertias of its descendants.
pub(crate) fn composites<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    bodies(model, data);
    compose(model, data);
}

/// Adds the inertias of the descendants to the inertia of every body.
#[inline]
pub(crate) fn compose<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    for (i, body) in model.bodies.iter().enumerate().rev() {
        if let Some(p) = body.parent {
            let (before, carried) = data.composite.split_at_mut(i);
            before[p] += &carried[0];
        }
    }
}

/// Computes the inertia of every single body.
#[inline]
pub(crate) fn bodies<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    for (inertia, (body, place)) in data.composite.iter_mut().zip(model.bodies.iter().zip(&data.placement)) {
        *inertia = body.spatial_inertia(place, &data.origin);
    }
}
