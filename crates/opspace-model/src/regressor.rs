//! Regressor of the inverse dynamics, which are linear in the inertial parameters.
//!
//! Atkeson, An and Hollerbach, *Estimation of inertial parameters of manipulator loads and links*, Int. J. Robotics
//! Research 5(3), 1986; in Pinocchio `computeJointTorqueRegressor`, with the same order of parameters.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, inertial_parameters, kinematics, rnea, torque_regressor};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! let parameters: Vec<f64> = model.bodies().iter().flat_map(|b| inertial_parameters(&b.inertia)).collect();
//! let mut regressor = nalgebra::DMatrix::zeros(6, parameters.len());
//! torque_regressor(&model, &mut data, &[1.0; 6], &mut regressor);
//! rnea(&model, &mut data, &[1.0; 6]);
//! let torque = regressor * nalgebra::DVector::from_vec(parameters);
//! assert!((torque - &data.torque).norm() < 1e-11);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::data::Data;
use crate::model::Model;
use crate::real::Real;
use crate::rnea::accelerate;
use crate::spatial::{Force, Inertia, Motion};
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Number of inertial parameters of a body.
pub const PARAMETERS: usize = 10;

/// Returns the inertial parameters π of a body: m, m c_x, m c_y, m c_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz, with I
/// about the origin and in the axes of the body frame (kg, kg m, kg m²).
#[must_use]
pub fn inertial_parameters(inertia: &Inertia) -> [f64; PARAMETERS] {
    let Inertia { mass, com, rotational } = inertia;
    let about_origin =
        rotational + (Matrix3::from_diagonal_element(com.norm_squared()) - com * com.transpose()) * *mass;
    let h = com * *mass;
    let i = |r, c| about_origin[(r, c)];
    [*mass, h.x, h.y, h.z, i(0, 0), i(0, 1), i(1, 1), i(0, 2), i(1, 2), i(2, 2)]
}

/// Computes the regressor Y(q, q̇, q̈) (n × 10 times the number of bodies) into `out`, at `ddq` (n; rad/s²). Y π is the
/// torque of [`rnea`](crate::rnea()) without rotors, with π the stacked [`inertial_parameters`] of all bodies. Needs
/// [`kinematics`](crate::kinematics()).
///
/// # Panics
/// If `ddq` is shorter than the number of joints, or if `out` has another size.
pub fn torque_regressor<T: Real>(model: &Model<T>, data: &mut Data<T>, ddq: &[T], out: &mut DMatrix<T>) {
    let bodies = model.bodies.len();
    assert_eq!(out.shape(), (model.n(), PARAMETERS * bodies), "n rows, ten columns a body");
    accelerate(model, data, &ddq[..model.n()]);
    out.as_mut_slice().fill(T::zero());
    for i in 0..bodies {
        let placement = &data.placement[i];
        let point = placement.translation - data.origin;
        let local = |m: &Motion<T>| m.shifted_to(&point).rotated_inverse(&placement.rotation);
        let v = local(&data.velocity[i]);
        let a = local(&(data.acceleration[i] + data.bias_acceleration[i]));
        let columns = body_regressor(&v, &a);
        for j in model.ancestry(Some(i)) {
            let screw = local(&data.screw[j]);
            for (k, column) in columns.iter().enumerate() {
                out[(model.bodies[j].joint, PARAMETERS * i + k)] += screw.dot(column);
            }
        }
    }
}

/// Returns the force on a body per unit of each of its parameters, for its velocity and acceleration in the body frame:
/// `f = m a_o + α × h + ω × (ω × h)`, `n = I α + ω × I ω + h × a_o`, with a_o the classical acceleration of its origin.
fn body_regressor<T: Real>(v: &Motion<T>, a: &Motion<T>) -> [Force<T>; PARAMETERS] {
    let (w, alpha) = (&v.angular, &a.angular);
    let at_origin = a.linear + w.cross(&v.linear);
    let moment = |r: usize, c: usize| {
        // Product of a vector and the matrix I with ones at (r, c) and (c, r).
        let apply = |x: &Vector3<T>| {
            let mut y = Vector3::zeros();
            y[r] = x[c];
            y[c] = x[r];
            y
        };
        Force { linear: Vector3::zeros(), angular: apply(alpha) + w.cross(&apply(w)) }
    };
    let first = |axis: usize| {
        let e = Vector3::ith(axis, T::one());
        Force { linear: alpha.cross(&e) + w.cross(&w.cross(&e)), angular: e.cross(&at_origin) }
    };
    let mass = Force { linear: at_origin, angular: Vector3::zeros() };
    [
        mass,
        first(0),
        first(1),
        first(2),
        moment(0, 0),
        moment(0, 1),
        moment(1, 1),
        moment(0, 2),
        moment(1, 2),
        moment(2, 2),
    ]
}
