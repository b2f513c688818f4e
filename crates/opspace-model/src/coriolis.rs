//! Coriolis matrix from Christoffel symbols.
//!
//! Echeandia and Wensing, *Numerical methods to compute the Coriolis matrix and Christoffel symbols for rigid-body
//! systems*, J. Computational and Nonlinear Dynamics 16(9), 2021; in Pinocchio `computeCoriolisMatrix`. Many matrices C
//! satisfy C q̇ = h − g. This one also satisfies Ṁ = C + Cᵀ, and its entries are the Christoffel symbols times q̇.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, bias, coriolis, gravity, kinematics};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! coriolis(&model, &mut data);
//! bias(&model, &mut data);
//! gravity(&model, &mut data);
//! let torque = &data.coriolis_matrix * &data.dq;
//! assert!((torque - (&data.bias - &data.gravity)).norm() < 1e-12);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::crba::bodies;
use crate::data::Data;
use crate::jacobian::screw_rate;
use crate::model::Model;
use crate::real::Real;
use crate::spatial::{Force, Motion, SpatialInertia, skew};
use nalgebra::{Matrix3, Vector3};

/// Velocity terms of one or more bodies: `B = ½ (v ×* I − I v × + (I v) ×̄*)`, where `f ×̄* m` is `m ×* f`. As a 6×6
/// matrix, only two of its blocks are not zero: `[0, −l ×; 0, D]`. The terms of several bodies are added, like
/// inertias.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CoriolisFactor<T> {
    /// Linear momentum l, Ns.
    linear: Vector3<T>,
    /// Block D, which multiplies the angular velocity.
    angular: Matrix3<T>,
}

impl<T: Real> CoriolisFactor<T> {
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Matrix3::zeros() }
    }

    /// Returns the factor of a body with velocity `v`: `2 D = ω× I − I ω× − k× − (u× h× + h× u×)`, with k its angular
    /// momentum and u its linear velocity.
    fn new(inertia: &SpatialInertia<T>, v: &Motion<T>) -> Self {
        let momentum = inertia.apply(v);
        let (w, h, u) = (skew(&v.angular), skew(&inertia.first_moment), skew(&v.linear));
        let second = &inertia.second_moment;
        let twice = w * second - second * w - skew(&momentum.angular) - (u * h + h * u);
        Self { linear: momentum.linear, angular: twice * T::splat(0.5) }
    }

    fn add(&mut self, other: &Self) {
        self.linear += other.linear;
        self.angular += other.angular;
    }

    /// Returns B m.
    pub fn apply(&self, m: &Motion<T>) -> Force<T> {
        Force { linear: m.angular.cross(&self.linear), angular: self.angular * m.angular }
    }

    /// Returns Bᵀ m.
    pub fn apply_transposed(&self, m: &Motion<T>) -> Force<T> {
        Force {
            linear: Vector3::zeros(),
            angular: self.linear.cross(&m.linear) + self.angular.tr_mul(&m.angular),
        }
    }
}

/// Computes C(q, q̇) into [`Data::coriolis_matrix`] (n × n, Nms/rad). Needs [`kinematics`](crate::kinematics()).
///
/// Entry (i, j) is zero unless i = j or one of the two joints is an ancestor of the other.
pub fn coriolis<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    composite_factors(model, data);
    data.coriolis_matrix.as_mut_slice().fill(T::zero());
    for (i, body) in model.bodies.iter().enumerate() {
        let (composite, factor) = (&data.composite[i], &data.coriolis_factor[i]);
        let (s, s_dot) = (data.screw[i], screw_rate(data, i));
        let along = composite.apply(&s_dot) + factor.apply(&s);
        let against = (composite.apply(&s), factor.apply_transposed(&s));
        data.coriolis_matrix[(body.joint, body.joint)] += s.dot(&along);
        for j in model.ancestry(body.parent) {
            let (s, s_dot) = (&data.screw[j], screw_rate(data, j));
            let ancestor = model.bodies[j].joint;
            data.coriolis_matrix[(ancestor, body.joint)] += s.dot(&along);
            data.coriolis_matrix[(body.joint, ancestor)] += s_dot.dot(&against.0) + s.dot(&against.1);
        }
    }
}

/// Computes the composite inertia and the composite velocity terms of every body, including its descendants.
pub(crate) fn composite_factors<T: Real>(model: &Model<T>, data: &mut Data<T>) {
    bodies(model, data);
    for (factor, (inertia, v)) in
        data.coriolis_factor.iter_mut().zip(data.composite.iter().zip(&data.velocity))
    {
        *factor = CoriolisFactor::new(inertia, v);
    }
    for (i, body) in model.bodies.iter().enumerate().rev() {
        if let Some(p) = body.parent {
            let (before, carried) = data.composite.split_at_mut(i);
            before[p] += &carried[0];
            let (before, carried) = data.coriolis_factor.split_at_mut(i);
            before[p].add(&carried[0]);
        }
    }
}
