//! The Coriolis matrix of Christoffel's symbols.
//!
//! Echeandia and Wensing, *Numerical methods to compute the Coriolis matrix and Christoffel symbols for
//! rigid-body systems*, J. Computational and Nonlinear Dynamics 16(9), 2021; in Pinocchio
//! `computeCoriolisMatrix`. Of the many C with C q̇ = h − g this is the one with Ṁ = C + Cᵀ whose entries are
//! the Christoffel symbols times q̇.

use crate::data::Data;
use crate::model::Model;
use crate::spatial::{Force, Inertia, Motion, Placement};
use nalgebra::{Matrix3, Vector3};

/// Every velocity term of a body, or of several: `B = ½ (v ×* I − I v × + (I v) ×̄*)`, where `f ×̄* m` is
/// `m ×* f`. In the blocks of a 6×6, only two are not zero: `[0, −l ×; 0, D]`. They add like inertias.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CoriolisFactor {
    /// l: linear momentum.
    linear: Vector3<f64>,
    /// D: what the angular velocity is mapped to.
    angular: Matrix3<f64>,
}

impl CoriolisFactor {
    pub fn zero() -> Self {
        Self { linear: Vector3::zeros(), angular: Matrix3::zeros() }
    }

    /// Of a body that moves at `v`: `2 D = ω× J − J ω× − k× − m (v× c× + c× v×)` with J the rotational inertia
    /// and k the angular momentum, both about the frame's origin.
    fn new(inertia: &Inertia, v: &Motion) -> Self {
        let momentum = inertia.apply(v);
        let (w, c, u) = (v.angular.cross_matrix(), inertia.com.cross_matrix(), v.linear.cross_matrix());
        let about_origin = inertia.rotational - c * c * inertia.mass;
        let twice = w * about_origin
            - about_origin * w
            - momentum.angular.cross_matrix()
            - (u * c + c * u) * inertia.mass;
        Self { linear: momentum.linear, angular: twice * 0.5 }
    }

    fn add(&mut self, other: &Self) {
        self.linear += other.linear;
        self.angular += other.angular;
    }

    /// B m.
    fn apply(&self, m: &Motion) -> Force {
        Force { linear: m.angular.cross(&self.linear), angular: self.angular * m.angular }
    }

    /// Bᵀ m.
    fn apply_transposed(&self, m: &Motion) -> Force {
        Force {
            linear: Vector3::zeros(),
            angular: self.linear.cross(&m.linear) + self.angular.tr_mul(&m.angular),
        }
    }
}

/// C(q, q̇) into [`Data::coriolis_matrix`] (n × n, Nms/rad). Needs [`kinematics`](crate::kinematics()).
///
/// Entry (i, j) is not zero only where one of the two joints carries the other. Everything is in world axes
/// at the world's origin, where the terms of a subtree just add up.
pub fn coriolis(model: &Model, data: &mut Data) {
    data.coriolis_matrix.fill(0.0);
    for (i, joint) in model.joints.iter().enumerate() {
        let placement = &data.placement_world[i];
        let inertia = placement.act_inertia(&joint.inertia);
        data.composite[i] = inertia;
        data.coriolis_factor[i] = CoriolisFactor::new(&inertia, &placement.act_motion(&data.velocity[i]));
    }
    for i in (0..model.n()).rev() {
        let (composite, factor) = (data.composite[i], data.coriolis_factor[i]);
        if let Some(p) = model.joints[i].parent {
            data.composite[p] = data.composite[p] + composite;
            data.coriolis_factor[p].add(&factor);
        }
        let (s, s_dot) = subspace(model, data, i);
        let along = composite.apply(&s_dot) + factor.apply(&s);
        let against = (composite.apply(&s), factor.apply_transposed(&s));
        data.coriolis_matrix[(i, i)] = s.dot(&along);
        let mut j = i;
        while let Some(p) = model.joints[j].parent {
            j = p;
            let (s, s_dot) = subspace(model, data, j);
            data.coriolis_matrix[(j, i)] = s.dot(&along);
            data.coriolis_matrix[(i, j)] = s_dot.dot(&against.0) + s.dot(&against.1);
        }
    }
}

/// S and Ṡ = v × S of a joint, in world axes at the world's origin.
fn subspace(model: &Model, data: &Data, i: usize) -> (Motion, Motion) {
    let placement: &Placement = &data.placement_world[i];
    let s = model.joints[i].kind.motion(1.0);
    (placement.act_motion(&s), placement.act_motion(&data.velocity[i].cross_motion(&s)))
}
