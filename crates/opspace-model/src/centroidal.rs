//! Centroidal momentum: momentum of the whole robot about its centre of mass.
//!
//! Orin, Goswami and Lee, *Centroidal dynamics of a humanoid robot*, Autonomous Robots 35, 2013; in Pinocchio `ccrba`
//! and `computeCentroidalMomentum`. World axes, linear part first. Rotors are not included.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, centroidal_map, centroidal_momentum, kinematics};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! centroidal_map(&model, &mut data);
//! let momentum = &data.centroidal_map * &data.dq;
//! let same = centroidal_momentum(&model, &data);
//! assert!((momentum.fixed_rows::<3>(3) - same.angular).norm() < 1e-12);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::crba::composites;
use crate::data::Data;
use crate::energy::{center_of_mass, momentum};
use crate::jacobian::add;
use crate::model::Model;
use crate::real::Real;
use crate::spatial::Force;
use nalgebra::Vector3;

/// Computes A(q) with A q̇ = [`centroidal_momentum`] into [`Data::centroidal_map`] (6 × n; kg m, kg m²). Needs
/// [`forward_kinematics`](crate::forward_kinematics).
pub fn centroidal_map<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    composites(model, data);
    let com = com_from_origin(model, data);
    data.centroidal_map.as_mut_slice().fill(T::zero());
    for (i, body) in model.bodies.iter().enumerate() {
        let momentum = data.composite[i].apply(&data.screw[i]).shifted_to(&com);
        add(&mut data.centroidal_map, body.joint, &momentum.linear, &momentum.angular);
    }
}

/// Returns the linear momentum (kg m/s) and the angular momentum about the centre of mass (kg m²/s), in world axes.
/// Needs [`kinematics`](crate::kinematics()).
#[must_use]
pub fn centroidal_momentum<T: Real>(model: &Model<T>, data: &Data<T>) -> Force<T> {
    let mut sum = Force::zero();
    for (i, v) in data.velocity.iter().enumerate() {
        sum += momentum(model, data, i, v);
    }
    sum.shifted_to(&com_from_origin(model, data))
}

fn com_from_origin<T: Real>(model: &Model<T>, data: &Data<T>) -> Vector3<T> {
    center_of_mass(model, data).map_or(Vector3::zeros(), |com| com - data.origin)
}
